"""Tours: in which order a robot best comes to all places, again and again.

Of up to ten places the closed tour is the shortest there is (R. Bellman, *Dynamic programming treatment of the
travelling salesman problem*, 1962; also M. Held and R. M. Karp). Of more it begins with the nearest place, and is then
improved by turning pieces round and by moving single places (G. A. Croes, *A method for solving traveling-salesman
problems*, 1958), until nothing helps. Ways may have one direction.
"""

from __future__ import annotations

import math
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import MapError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.maps.graph import Graph
    from mdm.models.matrices import Vector

__all__ = ["tour"]

_EXACT = 10
"""Places of which the shortest tour is found, in some tenths of a second."""
_LEAST = 1e-9


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
    order = _shortest(far) if len(names) <= _EXACT else _improved(_nearest_first(far), far)
    return tuple(names[index] for index in order)


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


def _nearest_first(far: Vector) -> list[int]:
    order = [0]
    while len(order) < len(far):
        order.append(min(set(range(len(far))) - set(order), key=lambda index: (far[order[-1], index], index)))
    return order


def _improved(order: list[int], far: Vector) -> list[int]:
    """Return an order that no piece turned round, and no place moved, makes shorter."""
    best, length = order, _length(order, far)
    found = True
    while found:
        found = False
        for other in _neighbours(best):
            if (shorter := _length(other, far)) < length - _LEAST:
                best, length, found = other, shorter, True
                break
    return best


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


def _length(order: list[int], far: Vector) -> float:
    return sum(float(far[one, other]) for one, other in pairwise([*order, order[0]]))


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
