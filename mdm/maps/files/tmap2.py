"""Graphs as LCAS's topological navigation keeps them: YAML, files `.tmap2`.

A node's zone, `verts`, is relative to its position and not turned with it. The actions of edges say how to drive, and
are the same for many: an edge's label is `to` and the name of its target.

Restrictions of nodes and edges are formulas of conditions, a kind with a value such as ``robot_short``: they hold where
the robot may go. A kind that is not given, such as ``obstacleFree``, is unknown. Forbidden places and ways are left
out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mdm.errors import FormatError, MapWarning
from mdm.formats.source import Inventory
from mdm.logic import parse
from mdm.maps.files.gathered import Gathered
from mdm.maps.graph import Edge, Graph, Node, Pose

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.maps.files.yaml_tree import Entry

_TILT = 0.01
"""How much of a turn, as the sine of half its angle, may be about another axis than the vertical one."""
_PLANNING, _RUNTIME = "restrictions_planning", "restrictions_runtime"
_TAKEN = {"nodes", "node", "transformation", "meta", "metric_map", "map", "name", "pointset", "edge_id", "action_type"}
_TAKEN |= {
    "nav_frame",
    "parent_frame",
    "pose",
    "properties",
    "verts",
    "edges",
    "xy_goal_tolerance",
    _PLANNING,
    _RUNTIME,
}
"""The keys that are read, or only name what is: all others with something in them are noted as not carried over."""
_DRIVES = {"move_base", "NavigateToPose", "navigate_to_pose"}
"""Actions of edges that drive to a pose, as every way of a graph is driven."""
_EMPTY: tuple[object, ...] = ("", "null", "~", [], {})


def read_tmap2(root: Entry, robot: Mapping[str, str]) -> Graph:
    """Read a topological map.

    Args:
        root: The text.
        robot: The properties of the robot, by which restrictions are judged.

    Raises:
        FormatError: If it is malformed, an edge leads nowhere, a node lies in an unknown frame, or a restriction of
            planning cannot be judged.
    """
    transformation = _Transformation(root.get("transformation", "the map"))
    gathered, judged = Gathered(), _Judge(robot)
    judged.note(root, "the map")
    forbidden = set()
    edges: list[tuple[Edge, Entry]] = []
    for item in root.need("nodes", "the map").list("nodes"):
        judged.note(item, "an item of nodes")
        node = item.need("node", "an item of nodes")
        name = node.need("name", "a node").string("name")
        judged.note(node, "a node")
        judged.note(node.get("properties", name), "properties")
        if not judged.allows(node, name):
            forbidden.add(name)
            continue
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
            judged.note(edge, "an edge")
            target = edge.need("node", f"an edge of {name}").string("the node of an edge")
            if judged.allows(edge, f"{name} to {target}"):
                edges.append((Edge(name, target, f"to {target}"), edge))
    if not gathered.names and forbidden:
        root.source.fail(f"all places are forbidden to this robot by {_PLANNING} or {_RUNTIME}")
    for each, edge in edges:
        if each.target not in forbidden:
            gathered.add_edge(each, edge.fail)
    graph = gathered.graph(root.source.fail)
    judged.left.warn(root.source.path, MapWarning)
    return graph


class _Judge:
    """Judges the restrictions of nodes and edges, and notes all that is left out or not carried over."""

    def __init__(self, robot: Mapping[str, str]) -> None:
        self._robot = robot
        self.left = Inventory()

    def note(self, entry: Entry | None, what: str) -> None:
        """Note the keys of an entry that are not read and have something in them."""
        for key, value in () if entry is None else entry.mapping(what).items():
            usual = key in _TAKEN or value.content in _EMPTY
            if not (usual or (key == "action" and value.content in _DRIVES)):
                shown = f" {value.content!r}" if isinstance(value.content, str) else ""
                self.left.leave(f"{key}{shown}", f"line {value.line}")

    def allows(self, entry: Entry, what: str) -> bool:
        """Whether the robot may go there; a condition that is known only while it drives is noted."""
        for key in (_PLANNING, _RUNTIME):
            given = entry.get(key, what)
            if given is None or given.content in _EMPTY:
                continue
            text = given.string(f"{key} of {what}")
            try:
                # Capitals do not count; what is not known of the robot is None.
                formula = parse(text)
                values: dict[str, bool | None] = {"True": True, "False": False}
                for name in formula.names - values.keys():
                    kind, _, value = name.partition("_")
                    values[name] = value.lower() == self._robot[kind].lower() if kind in self._robot else None
                allowed = formula.evaluate(values)
            except FormatError as error:
                given.fail(f"{key} of {what}, {text[:80]!r}, is no formula of conditions such as robot_short: {error}")
            if allowed is False:
                self.left.leave(f"what {key} {text!r} forbids", f"line {given.line}")
                return False
            if allowed is None and key == _PLANNING:
                given.fail(
                    f"{key} of {what}, {text!r}, cannot be judged: say what the robot is, for each KIND_VALUE in it by "
                    f"--robot KIND=VALUE, or robot={{KIND: VALUE}} in Python and in [places]"
                )
            if allowed is None:
                self.left.leave(f"{key} {text!r}", f"line {given.line}")
        return True


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
