"""Common to the verbs of maps: the files of a floor that are given, and pictures of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.formats.target import check_place, replacing
from mdm.maps.check import RADIUS
from mdm.maps.files.load import load_parts
from mdm.maps.files.occupancy import image_of
from mdm.maps.map import place_of
from mdm.maps.paths import Paths, passages, widest
from mdm.maps.picture import Picture, around, stacked
from mdm.maps.raster import Labels

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from mdm.maps.check import Problem
    from mdm.maps.files.building import BuildingParts
    from mdm.maps.files.load import Parts
    from mdm.maps.paths import Passage
    from mdm.maps.raster import Grid

_DETAIL = 800
"""Pixels of the longer side of a detail."""
_AROUND = 1.5
"""Metres around the place of a problem that its picture shows."""
_USUAL, _LARGEST = 1200, 3000
"""Pixels of the longer side of a whole floor."""
_OFF_WALLS = 0.2
"""Metres that a way is drawn further from walls than a robot must be."""
_APART = 70
"""Pixels between goals that are next to each other, in the middle."""


def settle(arguments: argparse.Namespace, *, graph_needed: bool = True) -> bool:
    """Take a single file beside the map as the graph; return whether the map is a building's file instead.

    Raises:
        UsageError: If there is no graph and one is needed, or there is more than a building's file.
    """
    if Path(arguments.map).suffix.lower() == ".toml":
        given = [name for name in ("labels", "graph", "names", "reach") if getattr(arguments, name) is not None]
        if given:
            raise UsageError(f"{arguments.map}: a building's file names maps, graphs and labels itself: give it alone")
        return True
    if arguments.graph is None:
        arguments.labels, arguments.graph = None, arguments.labels
    if arguments.graph is None and graph_needed:
        raise UsageError("the following arguments are required: GRAPH")
    return False


def check_one_floor(arguments: argparse.Namespace) -> None:
    """Refuse a building's file where a map is needed.

    Raises:
        UsageError: If it is one.
    """
    if Path(arguments.map).suffix.lower() == ".toml":
        raise UsageError(f"{arguments.map}: this is of a whole building: give the map of one floor, each in its turn")


def load(arguments: argparse.Namespace) -> Parts:
    """Load the files of a floor."""
    return load_parts(
        arguments.graph,
        grid=arguments.map,
        labels=arguments.labels,
        names=arguments.names,
        reach=arguments.reach,
        robot=kinds(arguments),
    )


def kinds(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the properties of the robot by their kinds."""
    return {kind: value for kind, _, value in (each.partition("=") for each in arguments.kinds) if value}


def inputs(arguments: argparse.Namespace) -> list[str]:
    """Return the files that are read of a floor, the image of the map too, none of which may be written."""
    given = (arguments.map, *(getattr(arguments, name, None) for name in ("labels", "graph", "names")))
    return [path for path in given if path is not None] + [str(image_of(arguments.map))]


def check_output(path: str, *sources: str) -> None:
    """Check, before anything is drawn, that a picture's file can be written, is a PNG, and is not an input.

    Raises:
        Error: If not.
    """
    if Path(path).suffix.lower() != ".png":
        raise Error(f"{Path(path)}: the picture cannot be written: its file ends in .png")
    check_place(path, *sources)


def keep(picture: Any, path: str | Path) -> None:
    """Write a picture as PNG."""
    with replacing(path) as file:
        picture.save(file, format="PNG", optimize=True)


def building_picture(building: BuildingParts, radius: float | None, *, coordinates: bool = False) -> Any:
    """Return a picture of the floors of a building one below the other, each with its name and where lifts lead.

    Args:
        building: The floors and lifts.
        radius: Of the robot, in metres; by default the usual one.
        coordinates: Whether there are lines of coordinates.
    """
    pictures = []
    for name, parts in building.floors.items():
        notes: dict[str, str] = {}
        for edge in building.graph.edges:
            floor, place = place_of(edge.source)
            if edge.lift is not None and floor == name:
                leads = f"{edge.lift} to {edge.target}, {edge.seconds:g} s"
                notes[place] = f"{notes[place]}; {leads}" if place in notes else leads
        pictures.append((name, floor_picture(parts, radius, coordinates=coordinates, notes=notes)))
    return stacked(pictures)


def floor_picture(
    parts: Parts, radius: float | None, *, coordinates: bool = False, notes: Mapping[str, str] | None = None
) -> Any:
    """Return a picture of a floor.

    Passages that are too narrow for a robot are left out, and of several between two places the widest is told.

    Args:
        parts: The floor.
        radius: Of the robot, in metres; by default the usual one.
        coordinates: Whether there are lines of coordinates.
        notes: The texts at the goals of places.
    """
    radius = RADIUS if radius is None else radius
    cells = np.argwhere(parts.labels.raster > 0)
    corners = [*_goals(parts, parts.graph.names)]
    if len(cells):
        corners += [tuple(cells.min(axis=0)), tuple(cells.max(axis=0))]
    window = around(parts.labels.frame, corners, 1.0)
    size, goals = _USUAL, np.array([parts.labels.frame.locate(node.goal.x, node.goal.y) for node in parts.graph.nodes])
    if len(goals) > 1:  # as much as lets names be read, within limits
        apart = np.hypot(*(goals[:, None] - goals[None, :]).transpose(2, 0, 1))
        near = np.median(np.sort(apart, axis=1)[:, 1])
        longer = max(window[2] - window[0], window[3] - window[1])
        size = int(min(max(_USUAL, longer * _APART / max(near, 1.0)), _LARGEST))
    picture = Picture(parts.labels, parts.grid, window, size=size)
    if coordinates:
        picture.coordinates()
    else:
        picture.scale()
    found = () if parts.grid is None else passages(parts.labels, parts.grid)
    _furnish(picture, parts, [passage for passage in found if passage.width >= 2 * radius], radius)
    for place, text in (notes or {}).items():
        picture.note(parts.graph.node(place).goal, text)
    return picture.finished()


def grid_picture(grid: Grid) -> Any:
    """Return a picture of the known part of a grid, with lines of coordinates."""
    known = np.argwhere(grid.free | grid.occupied)
    window = around(grid.frame, [tuple(known.min(axis=0)), tuple(known.max(axis=0))] if len(known) else [], 1.0)
    nothing = Labels(grid.frame, np.zeros(grid.frame.shape, dtype=np.uint16), ())
    picture = Picture(nothing, grid, window, size=_USUAL)
    picture.coordinates()
    return picture.finished()


def problem_picture(parts: Parts, problem: Problem, radius: float) -> Any:
    """Return a picture of the places that a problem is about; None where it is nowhere."""
    corners = [*problem.cells, *([] if problem.cells else _goals(parts, problem.places))]
    if not corners:
        return None
    picture = Picture(parts.labels, parts.grid, around(parts.labels.frame, corners, _AROUND), size=_DETAIL)
    if problem.kind == "goals":
        _furnish(picture, parts, [], radius)
        for name in problem.places:
            picture.circle(parts.graph.node(name).goal, radius)
    else:
        picture.shade(problem.cells)
        _furnish(picture, parts, [], radius)
        picture.ring(problem.cells)
    picture.scale()
    return picture.finished(problem.text)


def _furnish(picture: Picture, parts: Parts, shown: list[Passage], radius: float) -> None:
    best = widest(tuple(shown))
    for passage in shown:
        picture.passage(passage, told=best[frozenset(passage.places)] is passage)
    picture.graph(parts.graph, _routes(parts, radius))


def _routes(parts: Parts, radius: float) -> dict[frozenset[str], list[tuple[int, int]]]:
    """Return where the ways between two places turn: those of a robot that keeps off walls, as far as it can."""
    if parts.grid is None:
        return {}
    clearance = parts.grid.clearance()
    frame, goals = parts.labels.frame, {}
    for node in parts.graph.nodes:
        cell = frame.cell(node.goal.x, node.goal.y)
        if cell is not None:
            goals[node.name] = cell
    routes: dict[frozenset[str], list[tuple[int, int]]] = {}
    for edge in parts.graph.edges:
        pair = frozenset((edge.source, edge.target))
        if len(pair) < 2 or pair in routes or not pair <= goals.keys():
            continue
        ends = goals[edge.source], goals[edge.target]
        for metres in (radius + _OFF_WALLS, radius, 0.0):
            paths = Paths(frame, parts.grid.free & (clearance >= metres))
            if all(paths.open[cell] for cell in ends) and (way := paths.way(*ends)):
                routes[pair] = way
                break
    return routes


def _goals(parts: Parts, names: tuple[str, ...]) -> list[tuple[float, float]]:
    """Return the cells of the goals of places, of those that lie in the map."""
    goals = [parts.graph.node(name).goal for name in names]
    frame = parts.labels.frame
    return [frame.locate(goal.x, goal.y) for goal in goals if frame.cell(goal.x, goal.y) is not None]
