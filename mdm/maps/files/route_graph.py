"""Graphs as Nav2's route server reads them: GeoJSON, a point per place and a line per way, in one direction.

By rule nodes have a number and no name. A place is called by the `name` in its metadata, where it has one, else by its
number; likewise a way, whose label is else `to` and the name of its target. Goals have no yaw: it is 0.

A route's nodes need not be places. Those that have the same `zone` in their metadata are one place of that name, whose
goal is the node in their middle. Nodes on one point are one place too, with the name of the first. Ways within a place
are left out. Costs, operations and all else that a route server would heed are named as not carried over.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.checks import is_number
from mdm.errors import MapWarning
from mdm.formats.source import Inventory
from mdm.maps.files.gathered import Gathered
from mdm.maps.graph import Edge, Graph, Node, Pose

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import NoReturn

    from mdm.formats.source import Source

_TOLD = 5
"""Pairs of nodes on one point that are told."""
_TAKEN = {
    "": {"type", "features", "name", "date_generated"},
    "properties": {"id", "frame", "startid", "endid", "metadata"},
    "metadata": {"name", "zone", "id"},
}
"""The keys that are read, or only name what is, of a collection, and of a feature."""
_SHOWN = 80
"""Letters of a value that an error shows."""


class _Geometry(msgspec.Struct):
    type: str
    coordinates: Any


class _Properties(msgspec.Struct):
    id: int
    frame: str = "map"
    startid: int | None = None
    endid: int | None = None
    cost: float | None = None
    metadata: dict[str, Any] | None = None


class _Feature(msgspec.Struct):
    geometry: _Geometry
    properties: _Properties


class _Collection(msgspec.Struct):
    features: list[_Feature]


def read_route_graph(source: Source) -> Graph:
    """Read a route graph.

    Raises:
        FormatError: If it is malformed, a line begins or ends nowhere, or the nodes lie in different frames.
    """
    try:
        features = msgspec.json.decode(source.text, type=_Collection).features
    except msgspec.MsgspecError as error:
        source.fail(f"this is not a route graph in GeoJSON: {error}")
    except RecursionError:
        source.fail("values are nested too deep")
    gathered = Gathered()
    names = _add_places(source, features, gathered)
    for index, feature in enumerate(features):
        kind, fail = feature.geometry.type, _failing(source, index, feature)
        if kind in {"MultiLineString", "LineString"}:
            start, end = feature.properties.startid, feature.properties.endid
            if start is None or end is None:
                fail("an edge needs startid and endid")
            for number in (start, end):
                if number not in names:
                    fail(f"the edge leads from {start} to {end}, and there is no node {number}")
            label = _text(feature, "name", fail) or f"to {names[end]}"
            edge = Edge(names[start], names[end], label, feature.properties.cost)
            if edge.source != edge.target or feature.properties.startid == feature.properties.endid:
                gathered.add_edge(edge, fail)
        elif kind != "Point":
            fail(f"a Point, a LineString or a MultiLineString was expected, not a {kind}")
    graph = gathered.graph(source.fail)
    _note(source)
    return graph


def _note(source: Source) -> None:
    """Warn of what is in a route graph and not carried over."""
    left, collection = Inventory(), msgspec.json.decode(source.text)
    for key in sorted(collection.keys() - _TAKEN[""]):
        left.leave(key, "the collection")
    for feature in collection["features"]:
        properties = feature["properties"]
        for kind, given in (("properties", properties), ("metadata", properties.get("metadata") or {})):
            for key, value in given.items():
                if key not in _TAKEN[kind] and value not in (None, {}, []):
                    what = f"{key} {_short(value)}" if key == "operations" else key
                    left.leave(what, f"id {properties['id']}")
    left.warn(source.path, MapWarning)


def _add_places(source: Source, features: list[_Feature], gathered: Gathered) -> dict[int, str]:
    """Gather the places; return the place of each node, by the nodes' numbers."""
    names: dict[int, str] = {}
    frames: dict[str, None] = {}
    nodes: dict[str, list[Pose]] = {}  # of each place
    there: dict[Pose, str] = {}  # the place that has a point
    zones: set[str] = set()
    failing: dict[str, Callable[[str], NoReturn]] = {}
    twins: list[str] = []
    for index, feature in enumerate(features):
        if feature.geometry.type != "Point":
            continue
        number, fail = feature.properties.id, _failing(source, index, feature)
        frames[feature.properties.frame] = None
        if len(frames) > 1:
            fail(f"the nodes lie in different frames: {', '.join(frames)}")
        if number in names:
            fail("a second node has this id")
        pose, zone = _pose(feature, fail), _text(feature, "zone", fail)
        own = zone or _text(feature, "name", fail) or str(number)
        name = own if zone else there.setdefault(pose, own)
        if name in nodes and name == own and not (zone and name in zones):
            fail(f"a second place is called {name!r}")
        if name != own:
            twins.append(f"{name!r} and {own!r}")
        if zone:
            zones.add(zone)
        names[number] = name
        nodes.setdefault(name, []).append(pose)
        failing.setdefault(name, fail)
    for name, poses in nodes.items():
        x, y = (math.fsum(values) / len(poses) for values in zip(*((pose.x, pose.y) for pose in poses), strict=True))
        middle = min(poses, key=lambda pose: math.hypot(pose.x - x, pose.y - y))
        gathered.add_node(Node(name, middle), failing[name])
    if twins:
        text = f"{source.path}: nodes on one point are one place: {', '.join(twins[:_TOLD])}"
        warnings.warn(MapWarning(text + (f" and {len(twins) - _TOLD} more" * (len(twins) > _TOLD))), stacklevel=2)
    return names


def _failing(source: Source, index: int, feature: _Feature) -> Callable[[str], NoReturn]:
    def fail(message: str) -> NoReturn:
        source.fail(f"features[{index}], id {feature.properties.id}: {message}")

    return fail


def _text(feature: _Feature, key: str, fail: Callable[[str], NoReturn]) -> str | None:
    """Return a text of a feature's metadata, where it has one."""
    value = (feature.properties.metadata or {}).get(key)
    if value is None:
        return None
    return value if isinstance(value, str) and value else fail(f"the {key} is {value!r}; a text was expected")


def _pose(feature: _Feature, fail: Callable[[str], NoReturn]) -> Pose:
    coordinates = feature.geometry.coordinates
    numbers = isinstance(coordinates, list) and all(map(is_number, coordinates))
    if not numbers or len(coordinates) not in {2, 3}:
        fail(f"the coordinates x and y were expected, not {_short(coordinates)}")
    try:
        pose = Pose(float(coordinates[0]), float(coordinates[1]))
    except OverflowError:  # JSON has whole numbers of any size
        fail(f"the coordinates x and y were expected, not {_short(coordinates)}")
    return pose if pose.is_finite else fail(f"the coordinates {_short(coordinates)} are not finite")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
