"""The graph of places: where each is entered, and by which actions one comes from one to the next.

A tour is the order in which a robot best comes to all places, again and again. Of up to ten places the closed tour is
the shortest there is (R. Bellman, *Dynamic programming treatment of the travelling salesman problem*, 1962; also
M. Held and R. M. Karp). Of more it begins with the nearest place, and is then improved by turning pieces round and by
moving single places (G. A. Croes, *A method for solving traveling-salesman problems*, 1958), until nothing helps. Ways
may have one direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import MapError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.models.matrices import Vector

_EXACT = 10
"""Places of which the shortest tour is found, in some tenths of a second."""
_LEAST = 1e-9


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a robot is, or should be.

    Args:
        x: In metres.
        y: In metres.
        yaw: Where it looks, from the world's x axis anticlockwise, in radians.
        floor: The floor in whose frame this is, where there are several.
    """

    x: float
    y: float
    yaw: float = 0.0
    floor: str = field(default="", kw_only=True)

    @property
    def is_finite(self) -> bool:
        """Whether all its numbers are finite."""
        return math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.yaw)


@dataclass(frozen=True, slots=True)
class Node:
    """A place.

    Args:
        name: Its name; that of the predicate that is true there.
        goal: Where a robot goes that is sent there.
        zone: The corners of the polygon that it covers, in metres in the world, where the graph knows.
        tolerance: How near to the goal counts as arrived, in metres, where the graph knows.
    """

    name: str
    goal: Pose
    zone: tuple[tuple[float, float], ...] | None = None
    tolerance: float | None = None


@dataclass(frozen=True, slots=True)
class Edge:
    """A way from a place to another one.

    Args:
        source: The name of the place that it leads from.
        target: The name of the place that it leads to.
        label: The action that takes it, such as ``Up``.
        cost: Its cost, where the graph knows.
        lift: The lift that it takes to another floor, where it is not driven.
        seconds: How long that takes.
    """

    source: str
    target: str
    label: str
    cost: float | None = None
    lift: str | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Graph:
    """Places, and the labelled ways between them.

    Args:
        nodes: The places.
        edges: The ways. From a place at most one has a given label.

    Raises:
        MapError: If there is no place, two share a name, a name or label is no text, a goal or zone is not finite, a
            tolerance is not above 0, a way begins or ends nowhere, or two ways from a place have the same label.
    """

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]

    def __post_init__(self) -> None:
        if not self.nodes:
            raise MapError("the graph has no places")
        known: set[str] = set()
        for node in self.nodes:
            _check(node)
            if node.name in known:
                raise MapError(f"two places are called {node.name!r}")
            known.add(node.name)
        taken: dict[tuple[str, str], str] = {}
        for edge in self.edges:
            for end in (edge.source, edge.target):
                if end not in known:
                    raise MapError(
                        f"a way leads from {edge.source!r} to {edge.target!r}, and there is no place {end!r}; "
                        f"there are {', '.join(self.names)}"
                    )
            if not isinstance(edge.label, str) or not edge.label:
                raise MapError(
                    f"the way from {edge.source!r} to {edge.target!r} is called {edge.label!r}: give it a label"
                )
            before = taken.setdefault((edge.source, edge.label), edge.target)
            if before != edge.target:
                raise MapError(
                    f"from {edge.source!r} two ways are called {edge.label!r}: to {before!r} and to {edge.target!r}"
                )

    @cached_property
    def _by_name(self) -> dict[str, Node]:
        return {node.name: node for node in self.nodes}

    @cached_property
    def _ways(self) -> dict[tuple[str, str], Edge]:
        return {(edge.source, edge.label): edge for edge in self.edges}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the places."""
        return tuple(node.name for node in self.nodes)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The labels of the ways, in the order in which they first occur."""
        return tuple(dict.fromkeys(edge.label for edge in self.edges))

    def node(self, name: str) -> Node:
        """Return a place.

        Raises:
            MapError: If there is none of that name.
        """
        try:
            return self._by_name[name]
        except KeyError:
            raise MapError(f"there is no place {name!r}; there are {', '.join(self.names)}") from None

    def target(self, source: str, label: str) -> str | None:
        """Return where the way of a label leads to from a place; None where there is no such way."""
        way = self.way(source, label)
        return None if way is None else way.target

    def way(self, source: str, label: str) -> Edge | None:
        """Return the way of a label from a place; None where there is no such way."""
        return self._ways.get((source, label))


def _check(node: Node) -> None:
    """Refuse a place whose name, goal, zone or tolerance is none."""
    if not isinstance(node.name, str) or not node.name:
        raise MapError(f"a place is called {node.name!r}: give it a name")
    if not node.goal.is_finite:
        raise MapError(f"the goal of {node.name!r} is {node.goal}, which is not finite")
    if node.zone is not None and len(node.zone) < 3:
        raise MapError(f"the zone of {node.name!r} has {len(node.zone)} corners; 3 or more make an area")
    if not all(math.isfinite(x) and math.isfinite(y) for x, y in node.zone or ()):
        raise MapError(f"the zone of {node.name!r} has a corner that is not finite")
    if node.tolerance is not None and not 0 < node.tolerance < math.inf:
        raise MapError(f"the tolerance of {node.name!r} is {node.tolerance}: give metres above 0")


def tour(
    graph: Graph, places: Sequence[str] | None = None, lengths: Mapping[tuple[str, str], float] | None = None
) -> tuple[str, ...]:
    """Return places in the order in which a robot that goes the ways of a graph comes to all of them soon.

    Args:
        graph: The places and ways.
        places: Which places, the first one first; all of them by default.
        lengths: How long the ways are, by their ends; by default the distance of the goals.

    Raises:
        MapError: If there are fewer than two places, one is unknown or given twice, or one cannot be reached
            from another.
    """
    names = list(graph.names if places is None else places)
    for name in names:
        graph.node(name)
        if names.count(name) > 1:
            raise MapError(f"the tour comes to {name!r} twice: name each place once")
    if len(names) < 2:
        there = "; the graph has only this one: add places to it by hand" if len(graph.names) == 1 else ""
        raise MapError(f"a tour takes two places or more, not {', '.join(names) or 'none'}{there}")
    far = _distances(graph, lengths)[np.ix_(*2 * [[graph.names.index(name) for name in names]])]
    for one, other in np.argwhere(~np.isfinite(far)):
        raise MapError(f"no ways lead from {names[one]!r} to {names[other]!r}: a tour comes to both again and again")
    if len(names) <= _EXACT:
        return tuple(names[index] for index in _shortest(far))
    order = [0]
    while len(order) < len(far):
        order.append(min(set(range(len(far))) - set(order), key=lambda index: (far[order[-1], index], index)))
    return tuple(names[index] for index in _improved(order, far))


def _shortest(far: Vector) -> list[int]:
    """Return the shortest closed tour from the first place, by the shortest ways to each last place of each set."""
    best = {(1 << last, last): (float(far[0, last]), 0) for last in range(1, len(far))}
    for size in range(2, len(far)):
        for others in combinations(range(1, len(far)), size):
            whole = sum(1 << place for place in others)
            for last in others:
                rest = whole - (1 << last)
                best[whole, last] = min(
                    (best[rest, before][0] + float(far[before, last]), before) for before in others if before != last
                )
    whole = sum(1 << place for place in range(1, len(far)))
    _, last = min((best[whole, last][0] + float(far[last, 0]), last) for last in range(1, len(far)))
    order = []
    while last:
        order.append(last)
        whole, last = whole - (1 << last), best[whole, last][1]
    return [0, *reversed(order)]


def _improved(order: list[int], far: Vector) -> list[int]:
    """Return an order that no piece turned round, and no place moved, makes shorter."""

    def length(of: list[int]) -> float:
        return math.fsum(far[one, other] for one, other in pairwise([*of, of[0]]))

    best: list[int] | None = order
    while best is not None:
        order, most = best, length(best) - _LEAST
        best = next((other for other in _neighbours(order) if length(other) < most), None)
    return order


def _neighbours(order: list[int]) -> list[list[int]]:
    """Return the orders with the same first place and a piece turned round, or one place moved."""
    size, found = len(order), []
    for first in range(1, size):
        found += [
            [*order[:first], *reversed(order[first : last + 1]), *order[last + 1 :]] for last in range(first + 1, size)
        ]
        rest = [*order[:first], *order[first + 1 :]]
        found += [[*rest[:place], order[first], *rest[place:]] for place in range(1, size) if place != first]
    return found


def _distances(graph: Graph, lengths: Mapping[tuple[str, str], float] | None) -> Vector:
    """Return how far it is from each place to each other one by the ways of a graph, infinite where none lead there."""
    far = np.full((len(graph.nodes), len(graph.nodes)), math.inf)
    np.fill_diagonal(far, 0.0)
    for edge in graph.edges:
        one, other = graph.node(edge.source).goal, graph.node(edge.target).goal
        straight = math.hypot(one.x - other.x, one.y - other.y)
        ends = graph.names.index(edge.source), graph.names.index(edge.target)
        far[ends] = min(far[ends], straight if lengths is None else lengths[edge.source, edge.target])
    for middle in range(len(far)):  # Floyd and Warshall
        far = np.minimum(far, far[:, [middle]] + far[[middle], :])
    return far
