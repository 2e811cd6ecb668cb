"""Checks of a map: errors that would keep a robot from its goals, or its predicates from being true."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from mdm.checks import check_metres
from mdm.maps.map import Floors, place_of
from mdm.maps.paths import drivable, leads, needed_clearance, passages, route_sentence, undivided, widest
from mdm.maps.raster import border_distance
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from mdm.maps.graph import Graph, Node
    from mdm.maps.map import Lift, Map
    from mdm.maps.raster import Grid, Labels

RADIUS = 0.25
"""The radius of a robot, in metres, if nobody says another."""
MARGIN = 0.3
"""How deep inside a place a robot must be that comes into it, in metres, if nobody says another."""
_TOLD = ("entered", "left", "at_goal", "arrived", "reached", "next")
"""The predicates and events of a place, after its name and a dot."""
_SLACK = 1e-9
_SHOWN = 200
"""Cells of a stray colour that a problem names."""
_FEW = 4
"""Pieces of a place whose middles a problem names."""


@dataclass(frozen=True)
class Problem:
    """Something that is wrong with a map.

    Args:
        kind: Its subject: `greys`, `colours`, `goals`, `rooms`, `ways` or `lifts`.
        text: The problem in a sentence.
        places: The names of the places that it is about.
        cells: Rows and columns of cells where it is seen.
        floor: The floor that it is on, where there are several.
    """

    kind: str
    text: str
    places: tuple[str, ...] = ()
    cells: Sequence[tuple[int, int]] = ()
    floor: str = ""

    def on(self, floor: str) -> Problem:
        """Return the problem as one of a floor, which its sentence names."""
        return replace(self, text=f"{floor}: {self.text}", floor=floor)


def check(floor: Map | Floors, *, radius: float = RADIUS, margin: float = MARGIN) -> tuple[Problem, ...]:
    """Return the problems of a map.

    * A goal lies outside its own place, or so near to a cell that is not free that the robot does not fit, with 5 cm to
      spare.
    * A place, or its goal, is not so far from other places that a robot there counts as having come.
    * A way joins places that do not touch, or by a passage that is too narrow, with 5 cm on each side; or no path as
      wide leads from goal to goal; or it joins a place with itself. Places touch by a passage that is wide enough, and
      there is no way.
    * Not all places can be reached from each other.
    * A place is in two pieces or more in which a robot fits: one cannot drive from the one to the other within it.
    * A colour of the image of labels is no place's, and has fewer cells than any place, and than 1 % of all.
    * The name of a place stands for something else in formulas, so that `Places` would refuse it.
    * Of several floors: a robot does not fit where a lift stops, or no way on the floor leads there.

    Where the files are at hand, `mdm map check` also lists larger colours that are no place's and cover free cells.

    Checks that take a grid are left out where the map has none.

    Args:
        floor: The map, or several floors.
        radius: The radius of the robot, in metres.
        margin: How deep inside a place a robot must be that comes into it, in metres.

    Raises:
        MapError: If the radius or the margin is no length.
    """
    check_metres(radius, "the radius")
    check_metres(margin, "the margin")
    if not isinstance(floor, Floors):
        return tuple(examine(floor.labels, floor.graph, floor.grid, radius=radius, margin=margin))
    problems = [
        problem.on(name)
        for name, each in floor.maps.items()
        for problem in examine(each.labels, each.graph, each.grid, radius=radius, margin=margin, alone=False)
    ]
    grids = {name: each.grid for name, each in floor.maps.items()}
    return (*problems, *examine_lifts(floor.graph, floor.lifts, grids, radius=radius))


def examine(
    labels: Labels,
    graph: Graph,
    grid: Grid | None,
    *,
    radius: float,
    margin: float,
    colours: NDArray[np.uint32] | None = None,
    alone: bool = True,
) -> Iterator[Problem]:
    """Yield the problems of labels and a graph, of the places that both have.

    Where a floor is not alone, its places may be joined by way of another one: see `examine_lifts`.
    """
    for colour, count in sorted(labels.strays.items(), key=lambda item: -item[1]):
        cells = [] if colours is None else np.argwhere(colours == colour)[:_SHOWN].tolist()
        text = f"the colour {colour} is no place's, and has {counted(count, 'cell')}: a slip of the brush?"
        yield Problem("colours", text, (), [(row, column) for row, column in cells])
    if colours is not None and grid is not None:
        for colour, here in missing(labels, grid, colours).items():
            free, count = int(np.count_nonzero(here)), labels.unnamed[colour]
            text = (
                f"the colour {colour} is no place's, and {free:,} of its {count:,} cells are free: a place is missing?"
            )
            yield Problem("colours", text, (), [_inmost(here)])
    inside = border_distance(labels)
    shallow = {problem.places[0]: problem for problem in _shallow(labels, grid, inside, margin)}
    for node in graph.nodes:
        if node.name in labels.names:
            yield from _goal(node, labels, inside, 0.0 if node.name in shallow else margin)
    yield from shallow.values()
    if grid is not None:
        yield from _cramped([node for node in graph.nodes if node.name in labels.names], grid, radius)
        yield from _pieces(labels, grid, radius)
        yield from _ways(labels, graph, grid, radius)
    for edge in graph.edges:
        if edge.source == edge.target:
            text = f"the way {edge.label!r} from {edge.source!r} leads to where it comes from"
            yield Problem("ways", text, (edge.source,))
    if alone:
        yield from _apart(graph)
    yield from _names(tuple(dict.fromkeys((*labels.names, *graph.names))))


def examine_lifts(
    graph: Graph, lifts: Sequence[Lift], grids: Mapping[str, Grid | None], *, radius: float
) -> Iterator[Problem]:
    """Yield the problems of the lifts between floors, and of how the places of all floors hang together.

    Args:
        graph: The graph of all floors.
        lifts: The ways between them.
        grids: The grid of each floor.
        radius: The radius of the robot, in metres.
    """
    driven = {name: None if grid is None else drivable(grid, radius) for name, grid in grids.items()}
    joined = {end for edge in graph.edges if edge.lift is None for end in (edge.source, edge.target)}
    for lift in lifts:
        for stop in lift.stops:
            (floor, place), goal = place_of(stop), graph.node(stop).goal
            grid, fits = grids[floor], driven[floor]
            cell = None if grid is None else grid.frame.cell(goal.x, goal.y)
            if fits is not None and (cell is None or not fits[cell]):
                text = f"{lift.name!r} stops at {stop!r}, and a robot of {2 * radius:g} m cannot drive to its goal"
                yield Problem("lifts", text, (place,), floor=floor)
            others = [name for name in graph.names if name != stop and place_of(name)[0] == floor]
            if others and stop not in joined:
                text = f"{lift.name!r} stops at {stop!r}, and no way on the floor leads to that place or away from it"
                yield Problem("lifts", text, (place,), floor=floor)
    yield from _apart(graph)


def missing(labels: Labels, grid: Grid, colours: NDArray[np.uint32]) -> dict[int, NDArray[np.bool_]]:
    """Return the colours that are no place's, though most of their cells are free; and for each cell whether it is.

    Free cells to which nothing free leads from any place do not count, such as those around a building.
    """
    parts, _ = scipy.ndimage.label(grid.free)
    inside = grid.free & np.isin(parts, np.unique(parts[labels.raster > 0]))
    found = {}
    for colour in labels.unnamed.keys() - labels.strays.keys():
        cells = (colours == colour) & (inside | ~grid.free)
        here = cells & inside
        if 2 * np.count_nonzero(here) > np.count_nonzero(cells):
            found[colour] = here
    return dict(sorted(found.items()))


def _inmost(cells: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the cell that is furthest from all others than some cells."""
    depth = scipy.ndimage.distance_transform_edt(np.pad(cells, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return int(row), int(column)


def _goal(node: Node, labels: Labels, inside: NDArray[np.float64], margin: float) -> Iterator[Problem]:
    """Yield a problem for a goal that is not in its place, or not as deep in it as the margin."""
    where = f"the goal of {node.name!r}, ({node.goal.x:g}, {node.goal.y:g}),"
    cell = labels.frame.cell(node.goal.x, node.goal.y)
    if cell is None:
        yield Problem("goals", f"{where} lies outside the map", (node.name,))
        return
    own = labels.name(node.goal.x, node.goal.y)
    if own != node.name:
        yield Problem("goals", f"{where} lies in {repr(own) if own else 'no place'}", (node.name,), [cell])
    elif inside[cell] < margin - _SLACK:
        text = (
            f"{where} is {inside[cell]:.2f} m behind the border of its place, and a robot counts as having come there "
            f"only at {margin:g} m"
        )
        yield Problem("goals", text, (node.name,), [cell])


def _cramped(nodes: Sequence[Node], grid: Grid, radius: float) -> Iterator[Problem]:
    """Yield a problem for each goal at which a robot does not fit."""
    driven, clearance, needed = drivable(grid, radius), grid.clearance(), needed_clearance(grid, radius)
    for node in nodes:
        cell = grid.frame.cell(node.goal.x, node.goal.y)
        if cell is None or driven[cell]:
            continue
        text = f"the goal of {node.name!r}, ({node.goal.x:g}, {node.goal.y:g}), is "
        if clearance[cell] == 0:
            text += "not free in the map"
        elif clearance[cell] < needed:
            text += f"{clearance[cell]:.2f} m from what is not free, and the robot needs {needed:.3g} m to drive"
        else:
            text += "too near to a corner of what is not free for the robot to drive"
        yield Problem("goals", text, (node.name,), [cell])


def _shallow(labels: Labels, grid: Grid | None, inside: NDArray[np.float64], margin: float) -> Iterator[Problem]:
    for name in labels.names:
        own = labels.cells(name)
        if not own.any():
            continue  # told as a colour that nothing has
        free = own if grid is None else own & grid.free
        deepest = np.where(free if free.any() else own, inside, -1.0)
        row, column = np.unravel_index(int(deepest.argmax()), deepest.shape)
        cells = [(int(row), int(column))]
        if not free.any():
            yield Problem("rooms", f"{name!r} has no free cell", (name,), cells)
        elif deepest[row, column] < margin - _SLACK:
            text = (
                f"{name!r} is nowhere further than {deepest[row, column]:.2f} m from its border, and a robot counts as "
                f"having come there only at {margin:g} m"
            )
            yield Problem("rooms", text, (name,), cells)


def _pieces(labels: Labels, grid: Grid, radius: float) -> Iterator[Problem]:
    """Yield a problem for each place whose free cells do not hang together; pieces in which no robot fits count not."""
    driven, least = drivable(grid, radius), (2 * radius / grid.frame.resolution) ** 2
    for name in labels.names:
        own = labels.cells(name)
        numbers, _ = scipy.ndimage.label(own & grid.free, structure=np.ones((3, 3)))
        sizes = np.bincount(numbers.ravel())
        pieces = [_inmost(numbers == piece) for piece in np.unique(numbers[driven & own]) if sizes[piece] >= least]
        if len(pieces) > 1:
            where = ", ".join("({:.2f}, {:.2f})".format(*grid.frame.centre(*cell)) for cell in pieces[:_FEW])
            text = f"{name!r} is in {len(pieces)} pieces, around {where}: no path leads from one to another within it"
            yield Problem("rooms", text, (name,), pieces)


def _ways(labels: Labels, graph: Graph, grid: Grid, radius: float) -> Iterator[Problem]:
    found = passages(labels, grid)
    widths, crowded = widest(found), undivided(labels, grid, found)
    if crowded:
        yield Problem("rooms", route_sentence(len(crowded), len(graph.nodes)), crowded)
    wanted: dict[frozenset[str], tuple[str, str]] = {}
    for edge in graph.edges:
        ends = (edge.source, edge.target)
        if edge.source != edge.target and all(name in labels.names for name in ends):
            wanted.setdefault(frozenset(ends), ends)
    driven = drivable(grid, radius)
    open_pairs = {frozenset(passage.places) for passage in found if leads(passage, driven)}
    # In which part of what the robot can drive over each goal lies; 0 where it does not fit.
    numbers, _ = scipy.ndimage.label(driven)
    cells = {node.name: labels.frame.cell(node.goal.x, node.goal.y) for node in graph.nodes}
    parts = {name: int(numbers[cell]) for name, cell in cells.items() if cell is not None}
    needed = 2 * needed_clearance(grid, radius)
    robot = f"a robot of {2 * radius:g} m"
    for pair, (source, target) in wanted.items():
        passage, goals = widths.get(pair), {parts.get(source, 0), parts.get(target, 0)}
        if passage is None:
            text = "these places do not touch"
        elif pair not in open_pairs:
            wide = f"{passage.width:.2f} m"
            text = f"the widest passage is {wide}, too narrow for {robot}, which needs {needed:.3g} m to drive"
        elif len(goals) > 1 and 0 not in goals:
            text = f"what stands about leaves no path between their goals that is wide enough for {robot}"
        else:
            continue
        where = [] if passage is None else [passage.middle]
        yield Problem("ways", f"a way leads from {source!r} to {target!r}, and {text}", (source, target), where)
    unused = open_pairs - wanted.keys()
    for pair, passage in widths.items():
        one, other = passage.places
        if pair in unused and not (one in crowded and other in crowded):
            text = f"{one!r} and {other!r} touch by a passage of {passage.width:.2f} m, and no way leads through it"
            yield Problem("ways", text, (one, other), [passage.middle])


def _apart(graph: Graph) -> Iterator[Problem]:
    """Yield a problem for each group of places that is not joined with the others both ways."""
    start, ways = graph.names[0], [(edge.source, edge.target) for edge in graph.edges]
    ahead, behind = _reached(start, ways), _reached(start, [(target, source) for source, target in ways])
    for names, text in (
        ([name for name in graph.names if name not in ahead | behind], "no ways join {} with {!r}"),
        ([name for name in graph.names if name in behind - ahead], "{} cannot be reached from {!r}"),
        ([name for name in graph.names if name in ahead - behind], "from {} there is no way back to {!r}"),
    ):
        if names:
            told = ", ".join(map(repr, names[:5])) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
            yield Problem("ways", text.format(told, start), tuple(names))


def _reached(start: str, ways: Sequence[tuple[str, str]]) -> set[str]:
    following: dict[str, set[str]] = {}
    for source, target in ways:
        following.setdefault(source, set()).add(target)
    seen, left = {start}, [start]
    while left:
        new = following.get(left.pop(), set()) - seen
        seen |= new
        left.extend(new)
    return seen


def _names(places: Sequence[str]) -> Iterator[Problem]:
    """Yield a problem for each name that could not be a predicate's beside those of the other places."""
    from mdm.actors.predicates.declarations import ACTION_END  # noqa: PLC0415 - maps alone need no actors

    told = {f"{name}.{what}": name for name in places for what in _TOLD}
    for name in places:
        other = told.get(name)
        if other is not None:
            text = f"the name {name!r} is what {other!r} has for a predicate or an event: give one another name"
            yield Problem("rooms", text, (name, other))
        elif "/" in name or ACTION_END.fullmatch(name):
            stands = "another agent's predicate" if "/" in name else "the end of an action"
            yield Problem("rooms", f"the name {name!r} reads as {stands}: give the place another name", (name,))
