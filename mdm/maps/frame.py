"""The frame of a raster: where its cells lie in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import MapError

if TYPE_CHECKING:
    from mdm.models.matrices import Vector

__all__ = ["Frame"]


@dataclass(frozen=True)
class Frame:
    """Where the cells of a raster lie in the world.

    Row 0 is the uppermost, as in the images that rasters are read from. A cell has its lower and its left border, and
    neither of the others. The raster is turned about its lower left corner.

    Args:
        rows: The number of rows.
        columns: The number of columns.
        resolution: The side of a cell, in metres.
        x: The lower left corner of the raster, in metres.
        y: The same.
        yaw: The angle from the world's x axis to the lower border, anticlockwise, in radians.

    Raises:
        MapError: If there are no cells, the resolution is not positive, or a number is not finite.
    """

    rows: int
    columns: int
    resolution: float
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if self.rows < 1 or self.columns < 1:
            raise MapError(f"a raster of {self.rows} x {self.columns} cells has none")
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise MapError(f"the resolution is {self.resolution}: give the side of a cell in metres, above 0")
        if not all(math.isfinite(number) for number in (self.x, self.y, self.yaw)):
            raise MapError(f"the origin {self.x, self.y, self.yaw} is not finite")

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and of columns."""
        return self.rows, self.columns

    @cached_property
    def turn(self) -> tuple[float, float]:
        """The cosine and the sine of the yaw."""
        # Right angles exactly: the cosine of a quarter turn is no 6e-17.
        quarters = self.yaw / (math.pi / 2)
        if abs(quarters - round(quarters)) < 1e-12:
            return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
        return math.cos(self.yaw), math.sin(self.yaw)

    def cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Return the row and the column that a point lies in; None outside, and for what is not finite."""
        cosine, sine = self.turn
        along = (cosine * (x - self.x) + sine * (y - self.y)) / self.resolution
        up = (cosine * (y - self.y) - sine * (x - self.x)) / self.resolution
        if 0 <= along < self.columns and 0 <= up < self.rows:
            return self.rows - 1 - math.floor(up), math.floor(along)
        return None

    def locate(self, x: float, y: float) -> tuple[float, float]:
        """Return the row and the column, with fractions, whose `centre` is a point; also outside."""
        cosine, sine = self.turn
        along = (cosine * (x - self.x) + sine * (y - self.y)) / self.resolution
        up = (cosine * (y - self.y) - sine * (x - self.x)) / self.resolution
        return self.rows - 0.5 - up, along - 0.5

    def centre(self, row: float, column: float) -> tuple[float, float]:
        """Return the centre of a cell, in metres."""
        cosine, sine = self.turn
        along = (column + 0.5) * self.resolution
        up = (self.rows - row - 0.5) * self.resolution
        return self.x + cosine * along - sine * up, self.y + sine * along + cosine * up

    def centres(self) -> tuple[Vector, Vector]:
        """Return the x and the y of all cells' centres, each with the shape of the raster."""
        cosine, sine = self.turn
        along = (np.arange(self.columns) + 0.5) * self.resolution
        up = (self.rows - np.arange(self.rows)[:, None] - 0.5) * self.resolution
        return self.x + cosine * along - sine * up, self.y + sine * along + cosine * up
