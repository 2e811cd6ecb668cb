"""Graphs as LCAS's topological navigation keeps them: YAML, files `.tmap2`.

A node's zone, `verts`, is relative to its position and not turned with it. The actions of edges say how to drive, and
are the same for many: an edge's label is `to` and the name of its target.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mdm.maps.files.gathered import Gathered
from mdm.maps.graph import Edge, Graph, Node, Pose

if TYPE_CHECKING:
    from mdm.maps.files.yaml_tree import Entry

__all__ = ["read_tmap2"]

_TILT = 0.01
"""How much of a turn, as the sine of half its angle, may be about another axis than the vertical one."""


def read_tmap2(root: Entry) -> Graph:
    """Read a topological map.

    Raises:
        FormatError: If it is malformed, an edge leads nowhere, or a node lies in an unknown frame.
    """
    transformation = _Transformation(root.get("transformation", "the map"))
    gathered = Gathered()
    for item in root.need("nodes", "the map").list("nodes"):
        node = item.need("node", "an item of nodes")
        name = node.need("name", "a node").string("name")
        pose = node.need("pose", name)
        place = transformation.of(node, name)
        x, y = place.point(*_position(pose.need("position", name), name))
        yaw = _yaw(pose.need("orientation", name), f"the orientation of {name}") + place.yaw
        zone = [place.turned(*_position(corner, f"verts of {name}")) for corner in _list(node, "verts", name)]
        if len(zone) in {1, 2}:
            node.need("verts", name).fail(f"the verts of {name} are {len(zone)} points; 3 or more make an area")
        gathered.add_node(
            Node(
                name,
                Pose(x, y, math.remainder(yaw, math.tau)),
                tuple((x + along, y + up) for along, up in zone) or None,
                _tolerance(node, name),
            ),
            node.fail,
        )
        for edge in _list(node, "edges", name):
            target = edge.need("node", f"an edge of {name}").string("the node of an edge")
            gathered.add_edge(Edge(name, target, f"to {target}"), edge.fail)
    return gathered.graph(root.source.fail)


class _Transformation:
    """Where the frame of the nodes lies in that of the map."""

    def __init__(self, entry: Entry | None) -> None:
        what = "transformation"
        self.x = self.y = self.yaw = 0.0
        self._child, self._parent = "", "map"
        if entry is None:
            return
        for key in ("child", "topo_frame_id"):
            child = entry.get(key, what)
            self._child = self._child if child is None else child.string(key)
        parent = entry.get("parent", what)
        self._parent = self._parent if parent is None else parent.string("parent")
        self.x, self.y = _position(entry.need("translation", what), what)
        self.yaw = _yaw(entry.need("rotation", what), "the rotation")

    def of(self, node: Entry, name: str) -> _Transformation:
        """Return the transformation from a node's frame to the map's."""
        entry = node.get("nav_frame", name) or node.get("parent_frame", name)
        if entry is None:
            return self
        frame = entry.string("the frame")
        if frame in {self._child, "${transformation.topo_frame_id}"}:
            return self
        if frame == self._parent:
            return _Transformation(None)
        return entry.fail(f"{name} lies in the frame {frame!r}; {self._parent!r} was expected")

    def turned(self, x: float, y: float) -> tuple[float, float]:
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        return cosine * x - sine * y, sine * x + cosine * y

    def point(self, x: float, y: float) -> tuple[float, float]:
        x, y = self.turned(x, y)
        return self.x + x, self.y + y


def _list(node: Entry, key: str, name: str) -> list[Entry]:
    entry = node.get(key, name)
    return [] if entry is None or entry.content in ("", "null", "~") else entry.list(f"{key} of {name}")


def _position(entry: Entry, what: str) -> tuple[float, float]:
    return entry.need("x", what).number(f"x of {what}"), entry.need("y", what).number(f"y of {what}")


def _yaw(entry: Entry, what: str) -> float:
    x, y, z, w = (entry.need(key, what).number(f"{key} of {what}") for key in "xyzw")
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not length > 0:
        entry.fail(f"{what} is a quaternion of zeros: for no turn, w is 1")
    if math.hypot(x, y) > _TILT * length:
        entry.fail(f"{what} is not a turn about the vertical axis: x and y must be 0")
    return 2 * math.atan2(z, w)


def _tolerance(node: Entry, name: str) -> float | None:
    properties = node.get("properties", name)
    entry = None if properties is None else properties.get("xy_goal_tolerance", f"properties of {name}")
    if entry is None:
        return None
    tolerance = entry.number("xy_goal_tolerance")
    return tolerance if tolerance > 0 else entry.fail(f"xy_goal_tolerance is {tolerance:g}; it must be above 0")
