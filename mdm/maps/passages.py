"""Passages: where one comes from a place straight into another one, and how wide that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mdm.maps.grid import Grid
    from mdm.maps.labels import Labels

__all__ = ["Passage", "leads", "passages", "route_sentence", "undivided", "widest"]

_OPEN = 0.8
"""The share of the width of the narrower of two places from which a passage divides nothing."""
_FEW = 8
"""Places of which so many may be conventions without being a route."""


@dataclass(frozen=True, eq=False)
class Passage:
    """A passage between two places: a stretch of their border that is free.

    Args:
        places: The names of the two, in the order of the labels.
        width: Twice the largest clearance on the border, in metres; true to a cell.
        middle: The row and the column of the cell where it is widest.
        cells: The cells on both sides of the border, as rows of row and column.
    """

    places: tuple[str, str]
    width: float
    middle: tuple[int, int]
    cells: NDArray[np.intp]


def passages(labels: Labels, grid: Grid) -> tuple[Passage, ...]:
    """Return the passages between all places, the widest first.

    Free cells without a label count for the place from which they are reached first.
    """
    places = _spread(labels.raster, grid.free)
    clearance = grid.clearance()
    borders: dict[tuple[int, int], list[NDArray[np.intp]]] = {}
    widths = np.zeros(places.shape)
    for down, right in ((1, 0), (0, 1)):
        here = slice(0, places.shape[0] - down), slice(0, places.shape[1] - right)
        there = slice(down, None), slice(right, None)
        met = (places[here] != places[there]) & (places[here] > 0) & (places[there] > 0)
        cells = np.argwhere(met)
        ones, others = places[here][met].astype(int), places[there][met].astype(int)
        narrow = np.minimum(clearance[here][met], clearance[there][met])
        step = np.array([down, right])
        for side in (cells, cells + step):
            np.maximum.at(widths, tuple(side.T), narrow)
        pairs = np.minimum(ones, others) * (len(labels.names) + 1) + np.maximum(ones, others)
        for pair in np.unique(pairs):
            key = divmod(int(pair), len(labels.names) + 1)
            chosen = cells[pairs == pair]
            borders.setdefault(key, []).extend((chosen, chosen + step))
    found = [
        Passage((labels.names[one - 1], labels.names[other - 1]), *_measured(cells, widths))
        for (one, other), sides in borders.items()
        for cells in _stretches(np.unique(np.concatenate(sides), axis=0))
    ]
    return tuple(sorted(found, key=lambda passage: -passage.width))


def widest(found: tuple[Passage, ...]) -> dict[frozenset[str], Passage]:
    """Return the widest passage between each two places."""
    best: dict[frozenset[str], Passage] = {}
    for passage in found:
        best.setdefault(frozenset(passage.places), passage)
    return best


def leads(passage: Passage, driven: NDArray[np.bool_]) -> bool:
    """Whether a robot comes through a passage, from the cells that it can drive over."""
    return bool(driven[tuple(passage.cells.T)].any())


def undivided(labels: Labels, grid: Grid, found: tuple[Passage, ...]) -> tuple[str, ...]:
    """Return the places that nothing divides from a neighbour, where most are so: such as the points of a route.

    A passage divides where it is clearly narrower than both places are. A few places without a door between them are
    usual, and then none is returned.
    """
    wide = np.zeros(len(labels.names) + 1)
    np.maximum.at(wide, labels.raster.ravel(), grid.clearance().ravel())
    of = dict(zip(labels.names, (2 * wide[1:]).tolist(), strict=True))
    crowded = {
        name
        for passage in found
        for name in passage.places
        if passage.width >= _OPEN * min(of[place] for place in passage.places)
    }
    if len(crowded) < max(_FEW, len(labels.names) / 2):
        return ()
    return tuple(name for name in labels.names if name in crowded)


def route_sentence(crowded: int, places: int) -> str:
    """Return what is said of places that are no rooms, and what to do."""
    return (
        f"{crowded} of {places} places have a neighbour from which nothing divides them: are these the points of a "
        f"route, and no rooms? Give the nodes of a room the same `zone` in their metadata, or begin with the rooms "
        f"that mdm map goals proposes"
    )


def _measured(cells: NDArray[np.intp], widths: NDArray[np.float64]) -> tuple[float, tuple[int, int], NDArray[np.intp]]:
    along = widths[tuple(cells.T)]
    best = cells[along == along.max()]
    row, column = best[len(best) // 2]
    return 2 * float(along.max()), (int(row), int(column)), cells


def _stretches(cells: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return cells in groups that touch, at corners too."""
    low = cells.min(axis=0)
    mask = np.zeros(cells.max(axis=0) - low + 1, dtype=bool)
    mask[tuple((cells - low).T)] = True
    groups, count = ndimage.label(mask, structure=np.ones((3, 3)))
    of = groups[tuple((cells - low).T)]
    return [cells[of == group] for group in range(1, count + 1)]


def _spread(raster: NDArray[np.uint16], free: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return the labels of free cells; those without one get that from which they are reached first."""
    wide = raster.shape[1] + 2
    labels = np.pad(np.where(free, raster, 0), 1).ravel()
    open_cells = np.pad(free, 1).ravel()
    edge = np.flatnonzero(labels)
    while edge.size:
        reached = []
        for step in (-wide, -1, 1, wide):
            there = edge + step
            new = open_cells[there] & (labels[there] == 0)
            labels[there[new]] = labels[edge[new]]
            reached.append(there[new])
        edge = np.concatenate(reached)
    spread: NDArray[np.uint16] = labels.reshape(-1, wide)[1:-1, 1:-1]
    return spread
