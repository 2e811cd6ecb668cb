"""The map: a floor's grid, labels and graph, in the one form that all readers give; and floors that lifts join."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import MapError
from mdm.maps.graph import Edge, Graph
from mdm.maps.raster import Labels

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from mdm.maps.raster import Grid

_SPEED = 0.5
"""Metres a second at which ways are driven, as far as their goals are apart, where they are weighed against lifts."""


@dataclass(frozen=True, eq=False)
class Map:
    """A floor.

    Args:
        labels: Which place each cell belongs to.
        graph: How the places hang together.
        grid: Which cells are free, where that is known.

    Raises:
        MapError: If the grid and the labels lie differently, or names of the one are unknown to the other.
    """

    labels: Labels
    graph: Graph
    grid: Grid | None = None

    def __post_init__(self) -> None:
        if self.grid is not None and self.grid.frame != self.labels.frame:
            raise MapError(f"the labels lie as {self.labels.frame}, the grid as {self.grid.frame}")
        for some, others, where in (
            (self.labels.names, self.graph.names, "the graph"),
            (self.graph.names, self.labels.names, "the labels"),
        ):
            missing = [name for name in some if name not in others]
            if missing:
                raise MapError(f"{', '.join(map(repr, missing))}: not in {where}, which has {', '.join(others)}")


@dataclass(frozen=True)
class Lift:
    """A lift, or stairs or a ramp: a way between places of different floors that is not driven on a map.

    Args:
        name: Its name.
        stops: The places where it stops, from one end to the other, each with its floor: ``ground.Hall``.
        seconds: How long it takes from one stop to the next.
        one_way: Whether it goes only from the first stop towards the last.

    Raises:
        MapError: If there are fewer than two stops, two are on one floor, or the seconds are not above 0.
    """

    name: str
    stops: tuple[str, ...]
    seconds: float
    one_way: bool = False

    def __post_init__(self) -> None:
        floors = [place_of(stop)[0] for stop in self.stops]
        twice = [floor for index, floor in enumerate(floors) if floor in floors[:index]]
        if twice:
            raise MapError(f"{self.name!r} stops twice on the floor {twice[0]!r}: name one place of each floor")
        if len(self.stops) < 2:
            raise MapError(f"{self.name!r} leads nowhere: name the places of two floors or more where it stops")
        if not 0 < self.seconds < float("inf"):
            raise MapError(f"{self.name!r} takes {self.seconds} s: give seconds above 0")

    def ways(self) -> Iterator[Edge]:
        """Yield the ways from each stop to each other one, called by the lift and the floor: ``lift to upper``."""
        for start, source in enumerate(self.stops):
            for end, target in enumerate(self.stops):
                if start < end or (start > end and not self.one_way):
                    label = f"{self.name} to {place_of(target)[0]}"
                    yield Edge(source, target, label, lift=self.name, seconds=self.seconds * abs(end - start))


@dataclass(frozen=True, eq=False)
class Floors:
    """Several floors.

    A place is called by its floor and its name there, ``ground.Hall``. Its goal is in the frame of its floor.

    Args:
        maps: The floors by their names.
        lifts: The ways between them.
        start: The place where the robot is first, where that is known.

    Raises:
        MapError: If there is no floor, a name is none, or a place of a lift, or the start, is not on its floor.
    """

    maps: Mapping[str, Map]
    lifts: tuple[Lift, ...] = ()
    start: str | None = None

    def __post_init__(self) -> None:
        if self.start is not None:
            self.graph.node(self.start)
        else:
            _ = self.graph  # which checks the rest

    @cached_property
    def graph(self) -> Graph:
        """The places of all floors, with the ways on each and the lifts between them."""
        return joined({name: floor.graph for name, floor in self.maps.items()}, self.lifts)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the places, floor by floor, as the labels of each have them."""
        return tuple(f"{floor}.{place}" for floor, each in self.maps.items() for place in each.labels.names)

    @cached_property
    def labels(self) -> dict[str, Labels]:
        """The labels of each floor, whose indices are those of all `names`."""
        made, first = {}, 0
        for floor, each in self.maps.items():
            own = each.labels
            raster = np.where(own.raster > 0, own.raster + np.uint16(first), 0).astype(np.uint16)
            made[floor] = Labels(own.frame, raster, self.names)
            first += len(own.names)
        return made


def joined(graphs: Mapping[str, Graph], lifts: Iterable[Lift]) -> Graph:
    """Return one graph of the graphs of several floors and the lifts between them.

    Raises:
        MapError: If there is no floor, a floor's name is none, two lifts share a name, or one stops nowhere.
    """
    if not graphs:
        raise MapError("there are no floors: name one or more")
    nodes, edges = [], []
    for floor, graph in graphs.items():
        if not floor.strip() or not floor.isprintable() or "." in floor or "/" in floor:
            raise MapError(f"a floor is called {floor!r}: give it a name without '.' and '/'")
        nodes += [
            replace(node, name=f"{floor}.{node.name}", goal=replace(node.goal, floor=floor)) for node in graph.nodes
        ]
        edges += [
            replace(edge, source=f"{floor}.{edge.source}", target=f"{floor}.{edge.target}") for edge in graph.edges
        ]
    places, known = {node.name for node in nodes}, set()
    for lift in lifts:
        for stop in lift.stops:
            floor, _ = place_of(stop)
            if floor not in graphs:
                there = ", ".join(graphs)
                raise MapError(f"{lift.name!r} stops at {stop!r}, and there is no such floor; there are {there}")
            if stop not in places:
                there = ", ".join(f"{floor}.{name}" for name in graphs[floor].names)
                raise MapError(f"{lift.name!r} stops at {stop!r}, and there is no such place; there are {there}")
        if lift.name in known:
            raise MapError(f"two lifts are called {lift.name!r}")
        known.add(lift.name)
        edges += lift.ways()
    return Graph(tuple(nodes), tuple(edges))


def rides(graph: Graph, source: str, target: str) -> tuple[Edge, ...]:
    """Return the lifts that the quickest way from a place to another one takes, in their order; none where none is.

    Args:
        graph: Of all floors.
        source: Where the way begins.
        target: Where it ends.

    Raises:
        MapError: If no ways lead there.
    """
    best: dict[str, float] = {}
    queue: list[tuple[float, int, str, tuple[Edge, ...]]] = [(0.0, 0, source, ())]
    pushed = count(1)
    while queue:
        seconds, _, place, taken = heappop(queue)
        if place == target:
            return taken
        if seconds >= best.get(place, math.inf):
            continue
        best[place] = seconds
        here = graph.node(place).goal
        for edge in graph.edges:
            if edge.source == place:
                there, lasts = graph.node(edge.target).goal, edge.seconds
                if lasts is None:
                    lasts = math.dist((here.x, here.y), (there.x, there.y)) / _SPEED
                after = taken if edge.lift is None else (*taken, edge)
                heappush(queue, (seconds + lasts, next(pushed), edge.target, after))
    raise MapError(f"no ways and lifts lead from {source!r} to {target!r}")


def place_of(name: str) -> tuple[str, str]:
    """Return the floor of a place, and its name there.

    Raises:
        MapError: If the name has no floor.
    """
    floor, dot, place = name.partition(".")
    if not floor or not dot or not place:
        raise MapError(f"{name!r} names no place of a floor: write the floor first, with a dot, as in ground.Hall")
    return floor, place
