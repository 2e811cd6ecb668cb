"""Labels: which place each cell of a floor belongs to, and how deep inside it lies."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from mdm.errors import MapError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from mdm.maps.frame import Frame
    from mdm.models.matrices import Vector

__all__ = ["Labels"]

_MOST = 65_535
_BLACK = (0, 0xFF << 24)
"""The number of black, without and with opacity."""


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
        indices = {colour: index for index, colour in enumerate(names.values(), 1)}
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

        Black is none of them: it is what drafts have where there is no place, and on a large floor that is little.
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
        for label, box in enumerate(ndimage.find_objects(self.raster), 1):
            if box is not None:
                own = self.raster[box] == label
                depth[box][own] = self._depth(label, box)[own]
        return depth

    def _depth(self, label: int, box: tuple[slice, slice]) -> Vector:
        """Return how far each cell of the box around a place is from the next cell of another one.

        One looks around the box, and further away until what lies beyond cannot be nearer.
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
                far = ndimage.distance_transform_edt(~others)[inner]
            whole = seen.shape == self.raster.shape
            if whole or far[self.raster[box] == label].max() <= around:
                return far * self.frame.resolution
            around *= 2
