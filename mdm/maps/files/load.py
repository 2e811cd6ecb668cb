"""Loading a map from its files: the grid, the graph, and the labels, from an image or from the graph's own zones.

Which colour of an image is which place's, a file tells, or the goals that lie in it.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mdm.errors import FormatError, MapError, MapWarning
from mdm.formats.source import Source
from mdm.maps.check import Problem
from mdm.maps.files.image import read_image
from mdm.maps.files.occupancy import load_grid
from mdm.maps.files.route_graph import read_route_graph
from mdm.maps.files.tmap2 import read_tmap2
from mdm.maps.files.topological_map import read_topological_map
from mdm.maps.files.yaml_tree import read_yaml
from mdm.maps.graph import Graph
from mdm.maps.map import Map
from mdm.maps.paths import Paths
from mdm.maps.raster import Frame, Grid, Labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mdm.maps.graph import Node

_FAR = 1_000_000.0
"""Metres that no place reaches."""

GivenPath: TypeAlias = str | PathLike[str]
_WAYPOINTS = re.compile(r"node:\s*\n?\s*\S+\s*\n\s*waypoint:")
_TMAP2_IN_JSON = re.compile(r'"nodes"\s*:\s*\[')
_OPAQUE = 0xFF << 24
_SIDE = 0.05
_MOST = 4_000_000
_EDGE = 0.5
"""Metres around the zones of a graph that has no map."""


def load_map(
    graph: Graph | GivenPath,
    *,
    grid: Grid | GivenPath | None = None,
    labels: GivenPath | None = None,
    names: Mapping[str, int] | GivenPath | None = None,
    reach: float | None = None,
    robot: Mapping[str, str] | None = None,
) -> Map:
    """Load a map.

    The areas of the places come from an image of labels, which has the size of the grid's; or else from the zones of
    the graph. Where a graph has neither, `reach` says how far around its goal a place is.

    Args:
        graph: The graph, or its file: the original's `TopologicalMap` in XML, LCAS's `tmap2` in YAML, or a route graph
            of Nav2's in GeoJSON.
        grid: The occupancy grid, or its file: ROS's `map.yaml`. An image of labels needs one.
        labels: The image of labels, which has a colour for each place: PNG, BMP, PGM or PPM.
        names: The number of each place's colour, or its file: `predicate_labels.yaml`. Without, a place has the colour
            that is under its goal.
        reach: How far from its goal a place without zone reaches, in metres; over free cells, where there is a grid.
        robot: The properties of the robot, by which restrictions of a tmap2 are judged, such as ``{"robot": "short"}``.

    Raises:
        FormatError: If a file is missing or malformed, or the image has another size than the map.
        MapError: If the files do not fit each other, such as a goal that lies outside the map; or if Pillow or PyYAML
            is missing where one of them is needed (`pip install pillow pyyaml`).
    """
    return load_parts(graph, grid=grid, labels=labels, names=names, reach=reach, robot=robot).whole()


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a map, which need not fit each other.

    Args:
        labels: Which place each cell belongs to; places that have no colour of their own are left out.
        graph: How the places hang together.
        grid: Which cells are free, where that is known.
        colours: For each cell the number of its colour, where there is an image of labels.
        problems: Why these parts make no map.
    """

    labels: Labels
    graph: Graph
    grid: Grid | None
    colours: NDArray[np.uint32] | None = None
    problems: tuple[Problem, ...] = ()

    def whole(self) -> Map:
        """Return the map.

        Raises:
            MapError: If the parts do not fit each other.
        """
        if self.problems:
            raise MapError(self.problems[0].text)
        return Map(self.labels, self.graph, self.grid)


def load_parts(
    graph: Graph | GivenPath,
    *,
    grid: Grid | GivenPath | None = None,
    labels: GivenPath | None = None,
    names: Mapping[str, int] | GivenPath | None = None,
    reach: float | None = None,
    robot: Mapping[str, str] | None = None,
) -> Parts:
    """Load a map, as `load_map` does, whether or not its labels and its graph fit each other."""
    if reach is not None and not 0 < reach <= _FAR:
        raise MapError(f"places that reach {reach:g} m from their goals: give metres above 0, at most {_FAR:,.0f}")
    graph = graph if isinstance(graph, Graph) else load_graph(graph, robot=robot)
    grid = grid if grid is None or isinstance(grid, Grid) else load_grid(Path(grid))
    if labels is None:
        if names is not None:
            raise MapError("names are for the colours of an image of labels, and there is none")
        return Parts(labels_of(graph, grid.frame if grid else frame_of(graph, reach), reach, grid), graph, grid)
    if grid is None:
        raise MapError(f"{Path(labels)}: where an image of labels lies is told by a map: give the grid, too")
    if reach is not None:
        raise MapError("how far places reach is told by the image of labels: leave one of them out")
    image = read_image(labels)
    if image.shape != grid.frame.shape:
        (rows, columns), (high, wide) = image.shape, grid.frame.shape
        raise FormatError(
            f"the image of labels has {columns} x {rows} pixels, the map {wide} x {high}: they must be the same",
            file=Path(labels),
        )
    colours = image.numbers
    if names is None:
        chosen, problems = colours_under_goals(graph, colours, grid)
    else:
        given = names if isinstance(names, Mapping) else load_colours(Path(names))
        chosen, problems = colours_by_name(graph, colours, given)
    return Parts(Labels.from_colours(grid.frame, colours, chosen), graph, grid, colours, tuple(problems))


def load_graph(path: GivenPath, *, robot: Mapping[str, str] | None = None) -> Graph:
    """Load a graph, whose format is told by its content.

    Args:
        path: The file.
        robot: The properties of the robot, see `load_map`.

    Raises:
        FormatError: If the file is missing or malformed.
        MapError: If it is YAML, or a tmap2 in JSON, and PyYAML is not installed.
    """
    source = Source(Path(path))
    text = source.text.lstrip()
    if text.startswith("<"):
        return read_topological_map(source)
    if _WAYPOINTS.match(text):
        source.fail(
            "this is a text of nodes, waypoints and edges, as STRANDS's older .tmap files are, which is not read: "
            "export the map as a tmap2 in YAML"
        )
    if text.startswith("{") and not _TMAP2_IN_JSON.search(text):
        return read_route_graph(source)
    root = read_yaml(source)
    if isinstance(root.content, list):
        root.fail(
            "this is a list of nodes, as STRANDS's older maps in YAML are, which is not read: convert it to a tmap2"
        )
    if root.get("nodes", "the graph") is None:
        what = "; this is a map" if root.get("image", "the graph") else ""
        source.fail(f"a graph was expected: a TopologicalMap, a tmap2 with nodes, or a route graph in GeoJSON{what}")
    return read_tmap2(root, {} if robot is None else robot)


def colours_by_name(
    graph: Graph, colours: NDArray[np.uint32], names: Mapping[str, int]
) -> tuple[dict[str, int], list[Problem]]:
    """Return the colours of the places of a graph by names that are given, and the problems of these."""
    problems: list[Problem] = []
    of: dict[int, str] = {}
    for name, colour in names.items():
        if name not in graph.names:
            text = f"{name!r} has a colour, and is no place of the graph, which has {', '.join(graph.names)}"
            problems.append(Problem("colours", text))
        elif colour in of:
            text = f"{of[colour]!r} and {name!r} have the same colour, {colour}: give each its own"
            problems.append(Problem("colours", text, (of[colour], name)))
        else:
            of[colour] = name
    there = set(np.unique(colours).tolist())
    for colour, name in of.items():
        if colour not in there:
            hint = f"; with opacity, as in this image, it is {colour + _OPAQUE}" if colour + _OPAQUE in there else ""
            problems.append(Problem("colours", f"no pixel has the colour of {name!r}, {colour}{hint}", (name,)))
    problems += [
        Problem("colours", f"the names give no colour to {name!r}, a place of the graph", (name,))
        for name in graph.names
        if name not in names
    ]
    return {name: colour for colour, name in of.items()}, problems


def colours_under_goals(graph: Graph, colours: NDArray[np.uint32], grid: Grid) -> tuple[dict[str, int], list[Problem]]:
    """Return for each place the colour that is under its goal, and the problems of these."""
    problems: list[Problem] = []
    of: dict[int, str] = {}
    for node in graph.nodes:
        cell = grid.frame.cell(node.goal.x, node.goal.y)
        where = f"the goal of {node.name!r}, ({node.goal.x:g}, {node.goal.y:g}),"
        if cell is None:
            problems.append(Problem("goals", f"{where} lies outside the map", (node.name,)))
            continue
        colour = int(colours[cell])
        if not grid.free[cell]:
            text = f"{where} is not free in the map, so that the colour under it says nothing: move it, or give names"
            problems.append(Problem("goals", text, (node.name,), [cell]))
        elif colour in of:
            text = f"{where} and that of {of[colour]!r} lie on the same colour, {colour}: give each place its own"
            problems.append(Problem("colours", text, (of[colour], node.name), [cell]))
        else:
            of[colour] = node.name
    return {name: colour for colour, name in of.items()}, problems


def load_colours(path: str | Path) -> dict[str, int]:
    """Load the number of each place's colour, by the place's name.

    A number is decimal or begins with 0x. A negative one is that of an image with opacity, as 32 bits with a sign.

    Raises:
        FormatError: If the file is missing or malformed, or two places have the same colour.
        MapError: If PyYAML is not installed.
    """
    colours: dict[str, int] = {}
    root = read_yaml(Source(path))
    for name, entry in root.mapping("the colours").items():
        text = entry.string(name)
        try:
            number = int(text, 0)
        except ValueError:
            entry.fail(f"{name}: the number of a colour was expected, not {text!r}")
        if not -(1 << 31) <= number < 1 << 32:
            entry.fail(f"{name}: the number {number} is that of no colour: it has more than 32 bits")
        colours[name] = number % (1 << 32)
    if not colours:
        root.fail("no place has a colour")
    return colours


def frame_of(graph: Graph, reach: float | None) -> Frame:
    """Return a frame that holds all zones, in cells of 0.05 m; of more where there would be over four million.

    Raises:
        MapError: If a place has no zone, and `reach` is None.
    """
    points = np.array([point for node in graph.nodes for point in _outline(node, reach)])
    low, high = points.min(axis=0) - _EDGE, points.max(axis=0) + _EDGE
    width, height = high - low
    side = max(_SIDE, math.sqrt(float(width * height) / _MOST))
    return Frame(math.ceil(height / side), math.ceil(width / side), side, float(low[0]), float(low[1]))


def labels_of(graph: Graph, frame: Frame, reach: float | None, grid: Grid | None = None) -> Labels:
    """Return the labels of a graph's zones.

    A cell belongs to a place if its centre lies in the zone; where zones overlap, to that of the nearer goal, with one
    warning. A place without zone has the cells in no zone, up to `reach` metres from its goal, and nearer to it than
    to the goals of others without zone: where there is a grid, by ways over its free cells.

    Raises:
        MapError: If a place has no zone, and `reach` is None; or if a place has no cell.
    """
    raster = np.zeros(frame.shape, dtype=np.uint16)
    nearest = np.full(frame.shape, np.inf)
    overlaps: dict[tuple[str, str], int] = {}
    for label, node in sorted(enumerate(graph.nodes, 1), key=lambda item: item[1].zone is None):  # zones come first
        window, inside = _inside([frame.locate(*point) for point in _outline(node, reach)], frame)
        if not inside.size:
            continue
        # In metres, to the goal of the place.
        row, column = frame.locate(node.goal.x, node.goal.y)
        down = np.arange(window[0].start, window[0].stop)[:, None] - row
        across = np.arange(window[1].start, window[1].stop)[None, :] - column
        distances: NDArray[np.float64] = np.hypot(down, across) * frame.resolution
        place, distance = raster[window], distances
        if node.zone is None:
            held = np.array([True, *(each.zone is None for each in graph.nodes)])[place]
            inside = held & (distance <= (reach or 0.0))  # a circle, not its outline
            if grid is not None:
                distance = _by_free_cells(grid, window, node, inside)
                inside &= distance <= (reach or 0.0)
        else:
            for other, count in zip(*np.unique(place[inside & (place > 0)], return_counts=True), strict=True):
                overlaps[graph.nodes[other - 1].name, node.name] = int(count)
        taken = inside & (distance < nearest[window])
        place[taken] = label
        nearest[window][taken] = distance[taken]
    present = np.isin(np.arange(1, len(graph.nodes) + 1), raster)
    empty = [name for name, there in zip(graph.names, present, strict=True) if not there]
    if empty:
        raise MapError(
            f"no cell of the map belongs to {', '.join(empty)}: it lies outside the map, within others' zones, at "
            f"another's goal, or is smaller than a cell"
        )
    if overlaps:
        pairs = [f"{a} and {b} ({count * frame.resolution**2:.2g} m²)" for (a, b), count in overlaps.items()]
        told = ", ".join(pairs[:5]) + (f", and {len(pairs) - 5} more pairs" if len(pairs) > 5 else "")
        text = f"zones overlap: {told}; what they share belongs to the nearer goal"
        warnings.warn(MapWarning(text), stacklevel=2)
    return Labels(frame, raster, graph.names)


def _outline(node: Node, reach: float | None) -> Sequence[tuple[float, float]]:
    """Return the corners of a place's zone, or of the square around the circle that it has in place of one."""
    if node.zone is not None:
        return node.zone
    if reach is None:
        raise MapError(
            f"{node.name!r} has no zone: give an image with labels, or how far from its goal a place reaches"
        )
    x, y = node.goal.x, node.goal.y
    far = reach * math.sqrt(2)  # whichever way the map is turned
    return [(x - far, y - far), (x + far, y - far), (x + far, y + far), (x - far, y + far)]


def _inside(corners: list[tuple[float, float]], frame: Frame) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
    """Return the part of the raster that a polygon spans, and for its cells whether the centre is inside (even-odd)."""
    rows, columns = np.array(corners).T
    top, bottom = max(math.ceil(rows.min()), 0), min(math.floor(rows.max()) + 1, frame.rows)
    left, right = max(math.ceil(columns.min()), 0), min(math.floor(columns.max()) + 1, frame.columns)
    window = slice(top, max(bottom, top)), slice(left, max(right, left))
    down = np.arange(window[0].start, window[0].stop)[:, None]
    across = np.arange(window[1].start, window[1].stop)[None, :]
    inside = np.zeros((down.size, across.size), dtype=bool)
    for (row, column), (next_row, next_column) in zip(corners, corners[1:] + corners[:1], strict=True):
        if row != next_row:
            between = (down >= min(row, next_row)) & (down < max(row, next_row))  # half open: a corner counts once
            crossing = column + (down - row) * (next_column - column) / (next_row - row)
            inside ^= between & (across < crossing)
    return window, inside


def _by_free_cells(
    grid: Grid, window: tuple[slice, slice], node: Node, within: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the metres from the goal of a place to the cells of a window, by free ones among some; else infinite."""
    goal = grid.frame.cell(node.goal.x, node.goal.y)
    if goal is None:
        return np.full(within.shape, np.inf)
    cell = goal[0] - window[0].start, goal[1] - window[1].start
    open_cells = grid.free[window] & within
    open_cells[cell] = True
    rows, columns = within.shape
    return Paths(Frame(rows, columns, grid.frame.resolution), open_cells).distances([cell])[0]
