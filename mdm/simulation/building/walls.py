"""Walls: the straight lines between the cells of a grid that are free and those that are not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mdm.maps import Grid

__all__ = ["walls"]

Point = tuple[float, float]


def walls(grid: Grid) -> list[tuple[Point, Point]]:
    """Return the ends of all walls, in metres. What lies beyond the grid is a wall."""
    found = []
    padded = np.pad(grid.free, 1)
    for upright in (False, True):
        cells = padded.T if upright else padded
        borders = cells[1:] != cells[:-1]
        ends = np.diff(np.pad(borders, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        for line in np.flatnonzero(borders.any(axis=1)):
            for begin, end in np.flatnonzero(ends[line]).reshape(-1, 2).tolist():
                corners = [(float(line) - 0.5, begin - 1.5), (float(line) - 0.5, end - 1.5)]
                first, last = (corner[::-1] for corner in corners) if upright else corners
                found.append((grid.frame.centre(*first), grid.frame.centre(*last)))
    return found
