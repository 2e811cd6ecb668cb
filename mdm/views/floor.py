"""A floor with what moves on it, as text for a terminal and as pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.maps import Pose
from mdm.maps.picture import Picture, colour

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from mdm.maps import Map

    Ink = tuple[int, int, int]
    Point = tuple[float, float]

__all__ = ["FloorView", "Mark"]

_ARROWS = "→↗↑↖←↙↓↘"
_WALL = (58, 62, 72)
_RED = (214, 30, 60)
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
_TINT = 0.55
_LEAST_NAME = 3
_TRAIL, _TRAIL_SIGN = (30, 80, 220), "•"
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


class _Scale(NamedTuple):
    """How many cells are down half a character and across one, and how many characters there are."""

    down: float
    side: float
    wide: int
    high: int


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

    def text(
        self,
        marks: Iterable[Mark] = (),
        *,
        trail: Iterable[Point] = (),
        columns: int = 80,
        rows: int = 24,
        colours: bool = True,
        stretch: float = 1.0,
    ) -> str:
        """Return the floor as lines of text. Names stand within their places, shortened where there is no room.

        Args:
            marks: What is on it; of several in one character the last is shown.
            trail: Where a robot has been, in metres: a dot at each, below names and marks.
            columns: How many characters it may be wide.
            rows: How many lines it may have.
            colours: Whether places are told by colours (24-bit escape codes), two blocks a character; else walls are
                ``#``.
            stretch: How many times as wide as it is it may be drawn, to be as wide as it may.
        """
        scale = self._scaled(columns, rows, stretch)
        labels = self._sampled(scale)
        walls = (labels[::2] == 0) | (labels[1::2] == 0)
        signs = [[" " if colours or not wall else "#" for wall in line] for line in walls.tolist()]
        inks: dict[tuple[int, int], tuple[Ink, bool]] = {}
        self._write_names(signs, labels, scale)
        for place in filter(None, (self._at(scale, *point) for point in trail)):
            if signs[place[0]][place[1]] == " ":
                signs[place[0]][place[1]], inks[place] = _TRAIL_SIGN, (_TRAIL, False)
        for mark in marks:
            if (there := self._at(scale, mark.x, mark.y)) is not None:
                signs[there[0]][there[1]], inks[there] = mark.sign[:1] or mark.arrow, (mark.ink, True)
        if not colours:
            return "\n".join("".join(line).rstrip() for line in signs)
        return "\n".join(self._coloured(line, labels, row, inks) for row, line in enumerate(signs))

    def _scaled(self, columns: int, rows: int, stretch: float) -> _Scale:
        top, left, bottom, right = self._window
        down = max((right - left) / columns / stretch, (bottom - top) / (2 * rows))
        side = max((right - left) / columns, down / stretch)
        return _Scale(down, side, max(1, int((right - left) / side)), max(1, int((bottom - top) / down / 2)))

    def _at(self, scale: _Scale, x: float, y: float) -> tuple[int, int] | None:
        """Return the line and the column of a point; None where it is not drawn."""
        cell = self.floor.labels.frame.cell(x, y)
        if cell is None:
            return None
        row, column = (cell[0] - self._window[0]) / scale.down / 2, (cell[1] - self._window[1]) / scale.side
        return (int(row), int(column)) if 0 <= row < scale.high and 0 <= column < scale.wide else None

    def _sampled(self, scale: _Scale) -> NDArray[np.uint16]:
        """Return the place at the middle of each block of cells, 0 where much of the block is a wall."""
        top, left, _, _ = self._window
        down, side, wide, high = scale.down, scale.side, scale.wide, 2 * scale.high
        raster = self.floor.labels.raster
        rows = np.minimum((top + np.arange(high) * down).astype(int), raster.shape[0] - 1)
        columns = np.minimum((left + np.arange(wide) * side).astype(int), raster.shape[1] - 1)
        blocks = raster[rows[0] : rows[0] + math.ceil(high * down), columns[0] : columns[0] + math.ceil(wide * side)]
        starts = rows - rows[0], columns - columns[0]
        walls = np.add.reduceat(np.add.reduceat(blocks == 0, starts[0], axis=0, dtype=float), starts[1], axis=1)
        cells = np.add.reduceat(np.add.reduceat(np.ones(blocks.shape), starts[0], axis=0), starts[1], axis=1)
        middles = raster[
            np.ix_(
                np.minimum(rows + int(down / 2), raster.shape[0] - 1),
                np.minimum(columns + int(side / 2), raster.shape[1] - 1),
            )
        ]
        return np.where(walls > _WALLED * cells, 0, middles)

    def _write_names(self, signs: list[list[str]], labels: NDArray[np.uint16], scale: _Scale) -> None:
        """Write each name within its place, in the line below the goal or the nearest one that has room for it."""
        names = self.floor.labels.names
        for node in self.floor.graph.nodes:
            goal = self._at(scale, node.goal.x, node.goal.y)
            if goal is None or node.name not in names:
                continue
            inside = labels == names.index(node.name) + 1
            runs = [*_runs(inside[::2] & inside[1::2])]
            longest = max((last - first for _, first, last in runs), default=0)
            name = node.name if len(node.name) <= longest else node.name[: max(longest - 1, 0)] + "…"
            if longest < min(_LEAST_NAME, len(node.name)):
                continue
            best = []
            for row, first, last in runs:
                if last - first >= len(name):
                    start = max(first, min(goal[1] - len(name) // 2, last - len(name)))
                    beside = abs(start + len(name) // 2 - goal[1])
                    best.append((row == goal[0], abs(row - goal[0] - 1) + beside, row, start))
            *_, row, start = min(best)
            signs[row][start : start + len(name)] = name

    def _coloured(
        self,
        line: Sequence[str],
        labels: NDArray[np.uint16],
        row: int,
        inks: dict[tuple[int, int], tuple[Ink, bool]],
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
            elif ink[1]:
                code = f"\x1b[1m{_front(_WHITE)}{_back(ink[0])}"
            else:
                code = f"\x1b[1m{_front(ink[0])}{_back(upper)}"
            parts.append(sign if code == last else code + sign)
            last = code
        return "".join(parts) + "\x1b[0m"

    # -- Pictures ------------------------------------------------------------------------------------------------

    def image(
        self,
        marks: Iterable[Mark] = (),
        *,
        trail: Iterable[Point] = (),
        title: str = "",
        size: int = 900,
        radius: float = 0.25,
    ) -> Any:
        """Return the floor as a picture of Pillow's.

        Args:
            marks: What is on it: robots as discs with a nose, others as discs with a letter.
            trail: Where a robot has been, in metres: a line.
            title: Lines below it.
            size: How long its longer side is, in pixels.
            radius: Of a robot, in metres.

        Raises:
            MapError: If Pillow is not installed.
        """
        picture = Picture(self.floor.labels, self.floor.grid, self._window, size=size)
        for node in self.floor.graph.nodes:
            picture.name(node)
        picture.trail([*trail], _TRAIL)
        for mark in marks:
            picture.mark(Pose(mark.x, mark.y, mark.yaw), radius, mark.ink, mark.sign)
        return picture.finished(title)


def _runs(inside: NDArray[np.bool_]) -> Iterator[tuple[int, int, int]]:
    """Yield the row, the first column and the one after the last of what lies inside without a gap."""
    for row, line in enumerate(inside):
        edges = np.flatnonzero(np.diff(np.concatenate(([0], line.astype(np.int8), [0]))))
        for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            yield row, first, last


def _tint(label: int) -> Ink:
    if label == 0:
        return _WALL
    red, green, blue = (round(255 - _TINT * (255 - part)) for part in colour(label - 1))
    return red, green, blue


def _front(ink: Ink) -> str:
    return "\x1b[38;2;{};{};{}m".format(*ink)


def _back(ink: Ink) -> str:
    return "\x1b[48;2;{};{};{}m".format(*ink)
