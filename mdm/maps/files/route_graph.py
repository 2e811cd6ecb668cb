"""Graphs as Nav2's route server reads them: GeoJSON, a point per place and a line per way, in one direction.

By rule nodes have a number and no name. A place is called by the `name` in its metadata, where it has one, else by its
number; likewise a way, whose label is else `to` and the name of its target. Goals have no yaw: it is 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from mdm.maps.files.gathered import Gathered
from mdm.maps.graph import Edge, Graph, Node, Pose
from mdm.number import is_number

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import NoReturn

    from mdm.formats.source import Source

__all__ = ["read_route_graph"]

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
        source.fail(f"this is no route graph in GeoJSON: {error}")
    except RecursionError:
        source.fail("values are nested too deep")
    gathered = Gathered()
    names = _add_nodes(source, features, gathered)
    for index, feature in enumerate(features):
        kind, fail = feature.geometry.type, _failing(source, index, feature)
        if kind in {"MultiLineString", "LineString"}:
            gathered.add_edge(_edge(feature, names, fail), fail)
        elif kind != "Point":
            fail(f"a Point, a LineString or a MultiLineString was expected, not a {kind}")
    return gathered.graph(source.fail)


def _add_nodes(source: Source, features: list[_Feature], gathered: Gathered) -> dict[int, str]:
    """Gather the places; return their names by their numbers."""
    names: dict[int, str] = {}
    frames: dict[str, None] = {}
    for index, feature in enumerate(features):
        if feature.geometry.type != "Point":
            continue
        number, fail = feature.properties.id, _failing(source, index, feature)
        frames[feature.properties.frame] = None
        if len(frames) > 1:
            fail(f"the nodes lie in different frames: {', '.join(frames)}")
        if number in names:
            fail("a second node has this id")
        names[number] = _name(feature, fail) or str(number)
        gathered.add_node(Node(names[number], _pose(feature, fail)), fail)
    return names


def _edge(feature: _Feature, names: dict[int, str], fail: Callable[[str], NoReturn]) -> Edge:
    start, end = feature.properties.startid, feature.properties.endid
    if start is None or end is None:
        fail("an edge needs startid and endid")
    for number in (start, end):
        if number not in names:
            fail(f"the edge leads from {start} to {end}, and there is no node {number}")
    label = _name(feature, fail) or f"to {names[end]}"
    return Edge(names[start], names[end], label, feature.properties.cost)


def _failing(source: Source, index: int, feature: _Feature) -> Callable[[str], NoReturn]:
    def fail(message: str) -> NoReturn:
        source.fail(f"features[{index}], id {feature.properties.id}: {message}")

    return fail


def _name(feature: _Feature, fail: Callable[[str], NoReturn]) -> str | None:
    name = (feature.properties.metadata or {}).get("name")
    if name is None:
        return None
    return name if isinstance(name, str) and name else fail(f"the name is {name!r}; a text was expected")


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
