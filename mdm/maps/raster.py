"""Rasters of a floor: where their cells lie in the world, which are free, which place each belongs to, and how deep.

The look-up is from a point to the place that it lies in, as quickly as can be.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy

from mdm.errors import MapError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from mdm.models.matrices import Vector

_SLACK = 1e-9
"""Clearances are multiples of the resolution, and rounded."""
_MOST = 65_535
_BLACK = (0, 0xFF << 24)
"""The number of black, without and with opacity."""


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
        """Return the row and the column that a point lies in; None outside, and for numbers that are not finite."""
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


@dataclass(frozen=True, eq=False)
class Grid:
    """The occupancy grid of a floor. A cell that is neither free nor occupied is unknown.

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
        distances: Vector = scipy.ndimage.distance_transform_edt(inside)[1:-1, 1:-1] * self.frame.resolution
        return distances

    def clearance_to_edges(self) -> Vector:
        """Return for each cell the distance of its centre to the nearest edge of a cell that is not free, in metres."""
        rows, columns = self.frame.shape
        # The nearest point of a square to a centre has coordinates in whole or half cells.
        half = np.ones((2 * rows + 1, 2 * columns + 1), dtype=bool)
        half[[0, -1]] = half[:, [0, -1]] = False  # beyond the raster nothing is known to be free
        for below, beside in np.ndindex(3, 3):
            half[below : below + 2 * rows : 2, beside : beside + 2 * columns : 2] &= self.free
        distances: Vector = scipy.ndimage.distance_transform_edt(half)[1::2, 1::2] * (self.frame.resolution / 2)
        return distances


@dataclass(frozen=True, eq=False)
class Labels:
    """Which place each cell of a floor belongs to.

    Args:
        frame: Where its cells lie.
        raster: For each cell 0, or the place's index in `names`, counted from 1.
        names: The names of the places.
        unnamed: The colours of the image that stand for no place, with the number of cells of each.

    Raises:
        MapError: If the raster has another shape than the frame, holds an index that has no name, or two places
            share a name.
    """

    frame: Frame
    raster: NDArray[np.uint16]
    names: tuple[str, ...]
    unnamed: Mapping[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.raster.shape != self.frame.shape:
            raise MapError(f"the labels have the shape {self.raster.shape}, their frame {self.frame.shape}")
        if len(self.names) > _MOST:
            raise MapError(f"{len(self.names)} places are more than {_MOST}")
        if self.raster.max() > len(self.names):
            raise MapError(f"there are {len(self.names)} names, and a label {self.raster.max()}")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise MapError(f"two places are called {twice[0]!r}")

    @classmethod
    def from_colours(cls, frame: Frame, colours: NDArray[np.uint32], names: Mapping[str, int]) -> Labels:
        """Build labels from an image.

        Args:
            frame: Where its cells lie.
            colours: The number of each cell's colour.
            names: The colour of each place.

        Raises:
            MapError: If two places have the same colour.
        """
        of: dict[int, str] = {}
        for name, colour in names.items():
            if colour in of:
                raise MapError(f"{of[colour]!r} and {name!r} have the same colour, {colour:#08x}: give each its own")
            of[colour] = name
        indices = {colour: index for index, colour in enumerate(of, 1)}
        found, inverse, counts = np.unique(colours, return_inverse=True, return_counts=True)
        new = np.array([indices.get(int(colour), 0) for colour in found], dtype=np.uint16)
        unnamed = {int(c): int(count) for c, count in zip(found, counts, strict=True) if int(c) not in indices}
        return cls(frame, new[inverse].reshape(colours.shape), tuple(names), unnamed)

    def name(self, x: float, y: float) -> str | None:
        """Return the name of the place that a point lies in, in metres; None where it lies in none."""
        cell = self.frame.cell(x, y)
        label = 0 if cell is None else int(self.raster[cell])
        return self.names[label - 1] if label else None

    def cells(self, name: str) -> NDArray[np.bool_]:
        """Return for each cell whether it belongs to a place.

        Raises:
            MapError: If there is no such place.
        """
        if name not in self.names:
            raise MapError(f"there is no place {name!r}; there are {', '.join(self.names)}")
        own: NDArray[np.bool_] = self.raster == self.names.index(name) + 1
        return own

    @cached_property
    def strays(self) -> dict[int, int]:
        """The unnamed colours with fewer cells than any place, and than 1 % of all, and the numbers of their cells.

        Black is none of them: drafts have it where there is no place, and on a large floor that is little.
        """
        sizes = np.bincount(self.raster.ravel(), minlength=1)[1:]
        least = min([self.raster.size / 100, *sizes[sizes > 0].tolist()])
        return {colour: count for colour, count in self.unnamed.items() if count < least and colour not in _BLACK}

    @cached_property
    def depth(self) -> Vector:
        """For each cell how far it is from the next cell of another place, in metres; walls do not count.

        The distance is from centre to centre, 0 where there is no place, infinite where there is no other place.
        """
        depth = np.zeros(self.frame.shape)
        for label, box in enumerate(scipy.ndimage.find_objects(self.raster), 1):
            if box is not None:
                own = self.raster[box] == label
                depth[box][own] = self._depth(label, box)[own]
        return depth

    def _depth(self, label: int, box: tuple[slice, slice]) -> Vector:
        """Return how far each cell of the box around a place is from the next cell of another one.

        One looks around the box, and further away until nothing beyond can be nearer.
        """
        around = 1 + max(side.stop - side.start for side in box) // 8
        while True:
            window = tuple(
                slice(max(side.start - around, 0), min(side.stop + around, size))
                for side, size in zip(box, self.raster.shape, strict=True)
            )
            inner = tuple(
                slice(side.start - wide.start, side.stop - wide.start) for side, wide in zip(box, window, strict=True)
            )
            seen = self.raster[window]
            others = (seen != 0) & (seen != label)
            far: Vector = np.full(self.raster[box].shape, np.inf)
            if others.any():
                far = scipy.ndimage.distance_transform_edt(~others)[inner]
            whole = seen.shape == self.raster.shape
            if whole or far[self.raster[box] == label].max() <= around:
                return far * self.frame.resolution
            around *= 2


def border_distance(labels: Labels) -> Vector:
    """Return for each cell how far its centre is from the border of any other place, in metres.

    That is half a cell less than the depth, which is from centre to centre.
    """
    distances: Vector = labels.depth - labels.frame.resolution / 2
    return distances


def lookup(labels: Labels, margin: float) -> Callable[[float, float], int]:
    """Return a function from a point, in metres, to twice the label of its place; plus 1 where it lies deep in it.

    Deep is a cell whose centre is at least the margin away from the border of any other place. The function returns 0
    in no place, outside of the raster, and for numbers that are not finite.

    Hot path: 0.12 µs a call, 0.18 where the raster is turned. The label and whether it is deep are one number, so that
    there is one look into plain bytes, whose rows are those of the raster from the lowest up.
    """
    frame = labels.frame
    codes = labels.raster.astype(np.uint32) * 2 + (border_distance(labels) >= margin - _SLACK)
    codes[labels.raster == 0] = 0
    upwards = codes[::-1]
    raster: Sequence[int] = (
        upwards.astype(np.uint8).tobytes() if upwards.max() < 256 else array("L", upwards.ravel().tolist())
    )
    floor, left, lowest, side = math.floor, frame.x, frame.y, frame.resolution
    columns, width, height = frame.columns, float(frame.columns), float(frame.rows)
    cosine, sine = frame.turn

    def look_up(x: float, y: float) -> int:
        along = (x - left) / side
        up = (y - lowest) / side
        if 0.0 <= along < width and 0.0 <= up < height:
            return raster[floor(up) * columns + floor(along)]
        return 0

    def look_up_turned(x: float, y: float) -> int:
        x -= left
        y -= lowest
        along = (cosine * x + sine * y) / side
        up = (cosine * y - sine * x) / side
        if 0.0 <= along < width and 0.0 <= up < height:
            return raster[floor(up) * columns + floor(along)]
        return 0

    return look_up if (cosine, sine) == (1.0, 0.0) else look_up_turned
