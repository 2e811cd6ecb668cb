"""The occupancy grid: which cells of a floor are free, and which are not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from mdm.errors import MapError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mdm.maps.frame import Frame
    from mdm.models.matrices import Vector

__all__ = ["Grid"]

_SLACK = 1e-9
"""Clearances are multiples of the resolution, and rounded."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The occupancy grid of a floor. What is neither free nor occupied is unknown.

    Args:
        frame: Where its cells lie.
        free: For each cell whether it is free.
        occupied: For each cell whether it is occupied.

    Raises:
        MapError: If a raster has another shape than the frame, or a cell is both.
    """

    frame: Frame
    free: NDArray[np.bool_]
    occupied: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for what, raster in (("free", self.free), ("occupied", self.occupied)):
            if raster.shape != self.frame.shape:
                raise MapError(
                    f"the raster of what is {what} has the shape {raster.shape}, its frame {self.frame.shape}"
                )
        if np.any(self.free & self.occupied):
            raise MapError("a cell is both free and occupied")

    def fits(self, radius: float) -> NDArray[np.bool_]:
        """Return for each cell whether a robot of a radius in metres fits there: its clearance is as large."""
        fitting: NDArray[np.bool_] = self.free & (self.clearance() >= radius - _SLACK)
        return fitting

    def clearance(self) -> Vector:
        """Return for each cell the distance of its centre to the nearest centre of one that is not free, in metres."""
        inside = np.pad(self.free, 1)  # beyond the raster nothing is known to be free
        distances: Vector = ndimage.distance_transform_edt(inside)[1:-1, 1:-1] * self.frame.resolution
        return distances

    def clearance_to_edges(self) -> Vector:
        """Return for each cell the distance of its centre to the nearest edge of a cell that is not free, in metres."""
        rows, columns = self.frame.shape
        # The nearest point of a square to a centre has coordinates in whole or half cells.
        half = np.ones((2 * rows + 1, 2 * columns + 1), dtype=bool)
        half[[0, -1]] = half[:, [0, -1]] = False  # beyond the raster nothing is known to be free
        for below, beside in np.ndindex(3, 3):
            half[below : below + 2 * rows : 2, beside : beside + 2 * columns : 2] &= self.free
        distances: Vector = ndimage.distance_transform_edt(half)[1::2, 1::2] * (self.frame.resolution / 2)
        return distances
