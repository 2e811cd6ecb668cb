"""Which colour of an image of labels is which place's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.problem import Problem

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from mdm.maps.graph import Graph
    from mdm.maps.grid import Grid

__all__ = ["colours_by_name", "colours_under_goals"]

_OPAQUE = 0xFF << 24


def colours_by_name(
    graph: Graph, colours: NDArray[np.uint32], names: Mapping[str, int]
) -> tuple[dict[str, int], list[Problem]]:
    """Return the colours of the places of a graph by names that are given, and what is wrong with them."""
    problems: list[Problem] = []
    chosen: dict[str, int] = {}
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
            chosen[name] = colour
    there = {int(colour) for colour in np.unique(colours)}
    for name, colour in chosen.items():
        if colour not in there:
            hint = f"; with opacity, as in this image, it is {colour + _OPAQUE}" if colour + _OPAQUE in there else ""
            problems.append(Problem("colours", f"no pixel has the colour of {name!r}, {colour}{hint}", (name,)))
    problems += [
        Problem("colours", f"the names give no colour to {name!r}, a place of the graph", (name,))
        for name in graph.names
        if name not in names
    ]
    return chosen, problems


def colours_under_goals(graph: Graph, colours: NDArray[np.uint32], grid: Grid) -> tuple[dict[str, int], list[Problem]]:
    """Return for each place the colour that is under its goal, and what is wrong with these."""
    problems: list[Problem] = []
    chosen: dict[str, int] = {}
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
            chosen[node.name] = colour
    return chosen, problems
