"""A floor with what moves on it, as text for a terminal and as pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.maps import Pose
from mdm.maps.picture import Picture, colour

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from mdm.maps import Map

    Ink = tuple[int, int, int]

__all__ = ["FloorView", "Mark"]

_ARROWS = "→↗↑↖←↙↓↘"
_WALL = (58, 62, 72)
_RED = (214, 30, 60)
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
_TINT = 0.55
_WALLED = 0.3
"""The share of a block of cells that makes it a wall: thin ones would be lost, and doors must not be."""


@dataclass(frozen=True)
class Mark:
    """Something on a floor.

    Args:
        x: Where, in metres.
        y: The same.
        sign: A letter for it; a robot has none, and is an arrow.
        yaw: Where a robot looks, in radians.
        ink: Its colour: red, green and blue up to 255.
    """

    x: float
    y: float
    sign: str = ""
    yaw: float = 0.0
    ink: tuple[int, int, int] = _RED

    @property
    def arrow(self) -> str:
        """The arrow for where it looks."""
        return _ARROWS[round(self.yaw / (math.pi / 4)) % 8]


class FloorView:
    """Draws a floor again and again, with marks at other places each time.

    Args:
        floor: The map.
    """

    def __init__(self, floor: Map) -> None:
        self.floor = floor
        used = np.argwhere(floor.labels.raster > 0)
        (top, left), (bottom, right) = used.min(axis=0) - 8, used.max(axis=0) + 9
        rows, columns = floor.labels.frame.shape
        self._window = max(int(top), 0), max(int(left), 0), min(int(bottom), rows), min(int(right), columns)

    # -- Text ----------------------------------------------------------------------------------------------------

    def text(self, marks: Iterable[Mark] = (), *, columns: int = 80, rows: int = 24, colours: bool = True) -> str:
        """Return the floor as lines of text.

        Args:
            marks: What is on it; of several in one character the last is shown.
            columns: How many characters it may be wide.
            rows: How many lines it may have.
            colours: Whether places are told by colours (24-bit escape codes), two blocks a character; else walls are
                ``#``. Names are below goals.
        """
        top, left, bottom, right = self._window
        side = max((right - left) / columns, (bottom - top) / (2 * rows))  # cells across a character
        wide, high = max(1, math.floor((right - left) / side)), max(1, math.floor((bottom - top) / side / 2))
        labels = self._sampled(side, wide, 2 * high)
        signs = [[" "] * wide for _ in range(high)]
        if not colours:
            for row, column in np.ndindex(high, wide):
                if labels[2 * row, column] == 0 or labels[2 * row + 1, column] == 0:
                    signs[row][column] = "#"
        self._write_names(signs, side)
        inks: dict[tuple[int, int], Ink] = {}
        for mark in marks:
            cell = self.floor.labels.frame.cell(mark.x, mark.y)
            if cell is None:
                continue
            row, column = int((cell[0] - top) / side / 2), int((cell[1] - left) / side)
            if 0 <= row < high and 0 <= column < wide:
                signs[row][column] = mark.sign[:1] or mark.arrow
                inks[row, column] = mark.ink
        if not colours:
            return "\n".join("".join(line).rstrip() for line in signs)
        return "\n".join(self._coloured(line, labels, row, inks) for row, line in enumerate(signs))

    def _sampled(self, side: float, wide: int, high: int) -> NDArray[np.uint16]:
        """Return the place at the middle of each block of cells, 0 where much of the block is a wall."""
        top, left, _, _ = self._window
        raster = self.floor.labels.raster
        rows = np.minimum((top + np.arange(high) * side).astype(int), raster.shape[0] - 1)
        columns = np.minimum((left + np.arange(wide) * side).astype(int), raster.shape[1] - 1)
        blocks = raster[rows[0] : rows[0] + math.ceil(high * side), columns[0] : columns[0] + math.ceil(wide * side)]
        starts = rows - rows[0], columns - columns[0]
        walls = np.add.reduceat(np.add.reduceat(blocks == 0, starts[0], axis=0, dtype=float), starts[1], axis=1)
        cells = np.add.reduceat(np.add.reduceat(np.ones(blocks.shape), starts[0], axis=0), starts[1], axis=1)
        half = int(side / 2)
        middles = raster[
            np.ix_(np.minimum(rows + half, raster.shape[0] - 1), np.minimum(columns + half, raster.shape[1] - 1))
        ]
        return np.where(walls > _WALLED * cells, 0, middles)

    def _write_names(self, signs: list[list[str]], side: float) -> None:
        top, left, _, _ = self._window
        for node in self.floor.graph.nodes:
            cell = self.floor.labels.frame.cell(node.goal.x, node.goal.y)
            if cell is None:
                continue
            row = int((cell[0] - top) / side / 2) + 1
            if not 0 <= row < len(signs):
                continue
            start = int((cell[1] - left) / side) - len(node.name) // 2
            start = max(0, min(start, len(signs[row]) - len(node.name)))
            for column, letter in enumerate(node.name, start):
                if 0 <= column < len(signs[row]):
                    signs[row][column] = letter

    def _coloured(
        self, line: Sequence[str], labels: NDArray[np.uint16], row: int, inks: dict[tuple[int, int], Ink]
    ) -> str:
        parts: list[str] = []
        last = ""
        for column, sign in enumerate(line):
            upper, lower = (_tint(int(labels[2 * row + half, column])) for half in (0, 1))
            ink = inks.get((row, column))
            if sign == " ":
                code, sign = f"\x1b[22m{_front(upper)}{_back(lower)}", "▀"  # noqa: PLW2901 - drawn in its place
            elif ink is None:
                code = f"\x1b[22m{_front(_BLACK)}{_back(upper)}"
            else:
                code = f"\x1b[1m{_front(_WHITE)}{_back(ink)}"
            parts.append(sign if code == last else code + sign)
            last = code
        return "".join(parts) + "\x1b[0m"

    # -- Pictures ------------------------------------------------------------------------------------------------

    def image(self, marks: Iterable[Mark] = (), *, title: str = "", size: int = 900, radius: float = 0.25) -> Any:
        """Return the floor as a picture of Pillow's.

        Args:
            marks: What is on it: robots as discs with a nose, others as discs with a letter.
            title: A line below it.
            size: How long its longer side is, in pixels.
            radius: Of a robot, in metres.

        Raises:
            MapError: If Pillow is not installed.
        """
        picture = Picture(self.floor.labels, self.floor.grid, self._window, size=size)
        for node in self.floor.graph.nodes:
            picture.name(node)
        for mark in marks:
            picture.mark(Pose(mark.x, mark.y, mark.yaw), radius, mark.ink, mark.sign)
        return picture.finished(title)


def _tint(label: int) -> Ink:
    if label == 0:
        return _WALL
    red, green, blue = (round(255 - _TINT * (255 - part)) for part in colour(label - 1))
    return red, green, blue


def _front(ink: Ink) -> str:
    return "\x1b[38;2;{};{};{}m".format(*ink)


def _back(ink: Ink) -> str:
    return "\x1b[48;2;{};{};{}m".format(*ink)
