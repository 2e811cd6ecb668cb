"""A refuge: where a robot is out of the way of others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.paths import Paths

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    Cell = tuple[int, int]

__all__ = ["refuge"]

_REACH = 8.0
"""Metres around a robot where a refuge is looked for."""
_BESIDE = 0.4
"""Metres between a robot in its refuge and one that passes."""


def refuge(paths: Paths, here: Cell, others: Iterable[tuple[Cell, Sequence[Cell], float]]) -> list[Cell] | None:
    """Return the way to the nearest cell that is off the ways of others, without driving through them.

    It costs some 20 ms.

    Args:
        paths: Where the robot may drive.
        here: Where it is.
        others: Where each other robot is, where its way turns, and the metres between the two where they touch.

    Returns:
        The cells where the way turns, and its end; None if there is no such cell.
    """
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415 - slow to import

    metres = paths.frame.resolution
    rows, columns = np.indices(paths.frame.shape)

    def near(cell: Cell, distance: float) -> np.ndarray:
        result: np.ndarray = np.hypot(rows - cell[0], columns - cell[1]) * metres < distance
        return result

    open_cells = paths.open & near(here, _REACH)
    off_the_way = open_cells.copy()
    for there, turns, touching in others:
        open_cells &= ~near(there, touching)
        way = np.ones(paths.frame.shape, dtype=bool)
        for one, other in zip((there, *turns), turns, strict=False):
            count = max(abs(other[0] - one[0]), abs(other[1] - one[1])) + 1
            way[
                np.linspace(one[0], other[0], count).round().astype(int),
                np.linspace(one[1], other[1], count).round().astype(int),
            ] = False
        way[there] = False
        off_the_way &= distance_transform_edt(way) * metres > touching + _BESIDE
    open_cells[here] = True
    around = Paths(paths.frame, open_cells)
    distances = np.where(off_the_way, around.distances([here])[0], np.inf)
    row, column = np.unravel_index(distances.argmin(), distances.shape)
    end = int(row), int(column)
    if not np.isfinite(distances[end]):
        return None
    return around.route(around.distances([end])[0], here)
