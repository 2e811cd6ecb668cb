"""A floor with robots and people on it, as text for a terminal, as pictures and as films."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy

from mdm.errors import Error
from mdm.formats.target import check_place, replacing
from mdm.maps import Pose
from mdm.maps.picture import Picture, colour
from mdm.views.palette import Palette

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from os import PathLike

    from numpy.typing import NDArray

    from mdm.maps import Map
    from mdm.maps.picture import Ink

    Point = tuple[float, float]

_ARROWS = "→↗↑↖←↙↓↘"
_WALL = (58, 62, 72)
_RED = (214, 30, 60)
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
_TINT = 0.55
_LEAST_NAME = 3
_TRAIL, _TRAIL_SIGN = (30, 80, 220), "•"
_WALLED = 0.3
"""The share of a block of cells that makes it a wall: thin ones would be lost, and doors must not be."""
_OUTSIDE = -1
_AROUND = 8
"""Cells around the places that are drawn, also where the raster ends."""
_THICK = 0.15
"""Metres of the walls around places that are drawn, where nothing lies behind."""
_SHEET = 12
"""Pictures on a sheet, at most."""
_GAP = 8
_COLOURS = Palette()


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
        (top, left), (bottom, right) = used.min(axis=0) - _AROUND, used.max(axis=0) + _AROUND + 1
        self._window = int(top), int(left), int(bottom), int(right)
        self._drawn: tuple[_Scale | None, NDArray[np.int64]] = None, np.zeros((0, 0), dtype=np.int64)
        self._outside = _outside(np.pad(floor.labels.raster, _AROUND), _THICK / floor.labels.frame.resolution)

    # -- Text ----------------------------------------------------------------------------------------------------

    def text(
        self,
        marks: Iterable[Mark] = (),
        *,
        trail: Iterable[Point] = (),
        columns: int = 80,
        rows: int = 24,
        palette: Palette = _COLOURS,
        stretch: float = 1.0,
    ) -> str:
        """Return the floor as lines of text. Names stand within their places, shortened where there is no room.

        Args:
            marks: The marks on it; of several in one character the last is shown.
            trail: Where a robot has been, in metres: a dot at each, below names and marks.
            columns: How many characters it may be wide.
            rows: How many lines it may have.
            palette: The terminal's colours, by which places are told, two blocks a character; where there are none,
                walls are ``#``. Outside of the walls is the terminal's own background.
            stretch: How many times as wide as it is it may be drawn, to be as wide as it may.
        """
        scale = self._scaled(columns, rows, stretch)
        if scale != self._drawn[0]:
            self._drawn = scale, self._sampled(scale)
        labels = self._drawn[1]
        walls = (labels[::2] == 0) | (labels[1::2] == 0)
        signs = [[" " if palette or not wall else "#" for wall in line] for line in walls.tolist()]
        inks: dict[tuple[int, int], tuple[Ink, bool]] = {}
        self._write_names(signs, labels, scale)
        for place in filter(None, (self._at(scale, *point) for point in trail)):
            if signs[place[0]][place[1]] == " ":
                signs[place[0]][place[1]], inks[place] = _TRAIL_SIGN, (_TRAIL, False)
        for mark in marks:
            if (there := self._at(scale, mark.x, mark.y)) is not None:
                signs[there[0]][there[1]], inks[there] = mark.sign[:1] or mark.arrow, (mark.ink, True)
        if not palette:
            return "\n".join("".join(line).rstrip() for line in signs)
        return "\n".join(
            _coloured(
                line,
                labels[2 * row : 2 * row + 2],
                {column: ink for (at, column), ink in inks.items() if at == row},
                palette,
            )
            for row, line in enumerate(signs)
        )

    def _scaled(self, columns: int, rows: int, stretch: float) -> _Scale:
        top, left, bottom, right = self._window
        down = max((right - left) / columns / stretch, (bottom - top) / (2 * rows))
        side = max((right - left) / columns, down / stretch)
        wide, high = math.ceil((right - left) / side - 1e-9), math.ceil((bottom - top) / down / 2 - 1e-9)
        return _Scale(down, side, wide, high)

    def _at(self, scale: _Scale, x: float, y: float) -> tuple[int, int] | None:
        """Return the line and the column of a point; None where it is not drawn."""
        cell = self.floor.labels.frame.cell(x, y)
        if cell is None:
            return None
        row, column = (cell[0] - self._window[0]) / scale.down / 2, (cell[1] - self._window[1]) / scale.side
        return (int(row), int(column)) if 0 <= row < scale.high and 0 <= column < scale.wide else None

    def _sampled(self, scale: _Scale) -> NDArray[np.int64]:
        """Return the place at the middle of each block of cells; 0 where much is a wall, less where all is outside."""
        top, left, _, _ = self._window
        down, side, wide, high = scale.down, scale.side, scale.wide, 2 * scale.high
        raster = np.pad(self.floor.labels.raster, _AROUND)
        top, left = top + _AROUND, left + _AROUND
        rows = np.minimum((top + np.arange(high) * down).astype(int), raster.shape[0] - 1)
        columns = np.minimum((left + np.arange(wide) * side).astype(int), raster.shape[1] - 1)

        def share(cells: NDArray[np.bool_], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
            part = np.s_[rows[0] : rows[0] + math.ceil(high * down), columns[0] : columns[0] + math.ceil(wide * side)]
            inside = np.stack((cells[part], np.ones_like(cells[part])))
            counts = np.add.reduceat(inside, rows - rows[0], axis=1, dtype=float)
            counted, all_cells = np.add.reduceat(counts, columns - columns[0], axis=2)
            return np.asarray(counted / all_cells)

        lower = np.minimum(rows + int(down / 2), raster.shape[0] - 1)
        right = np.minimum(columns + int(side / 2), raster.shape[1] - 1)
        walls = share(raster == 0, rows, columns)
        thick = walls > _WALLED
        thin = _thin(walls, share(raster == 0, lower, columns)) | _thin(walls.T, share(raster == 0, rows, right).T).T
        seen = np.where(thick | thin, 0, raster[np.ix_(lower, right)].astype(np.int64))
        outside = share(self._outside, rows, columns) == 1
        edge = outside & ~scipy.ndimage.binary_dilation(~outside & (seen > 0))
        return np.where(edge, _OUTSIDE, np.where(outside, 0, seen))

    def _write_names(self, signs: list[list[str]], labels: NDArray[np.int64], scale: _Scale) -> None:
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
                    free = min(1, (last - first - len(name)) // 2)  # beside a wall, where there is room
                    start = max(first + free, min(goal[1] - len(name) // 2, last - free - len(name)))
                    beside = abs(start + len(name) // 2 - goal[1])
                    is_tight = last - first < len(name) + 2  # it would fill a door
                    best.append((is_tight, row == goal[0], abs(row - goal[0] - 1) + beside, row, start))
            *_, row, start = min(best)
            signs[row][start : start + len(name)] = name

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
            marks: The marks on it: robots as discs with a nose, others as discs with a letter.
            trail: Where a robot has been, in metres: a line.
            title: Lines below it.
            size: How long its longer side is, in pixels.
            radius: Of a robot, in metres.

        Raises:
            MapError: If Pillow is not installed.
        """
        (top, left, bottom, right), (rows, columns) = self._window, self.floor.labels.frame.shape
        window = max(top, 0), max(left, 0), min(bottom, rows), min(right, columns)
        picture = Picture(self.floor.labels, self.floor.grid, window, size=size)
        for node in self.floor.graph.nodes:
            below = replace(node.goal, y=node.goal.y - 2.5 * radius)  # where no robot covers it
            is_inside = self.floor.labels.name(below.x, below.y) == node.name
            picture.name(replace(node, goal=below) if is_inside else node)
        picture.trail([*trail], _TRAIL)
        for mark in marks:
            picture.mark(Pose(mark.x, mark.y, mark.yaw), radius, mark.ink, mark.sign)
        return picture.finished(title)


class Film:
    """A film of a floor: ``.gif`` for an animation, ``.png`` for a sheet of pictures from it.

    Args:
        view: The floor.
        path: Its file.
        size: How long the longer side of a picture is, in pixels.

    Raises:
        Error: If the file's name ends otherwise, or it cannot be written.
    """

    def __init__(self, view: FloorView, path: str | PathLike[str], *, size: int = 900) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in {".gif", ".png"}:
            raise Error(f"{self.path}: a film ends in .gif, or in .png for a sheet of its pictures")
        check_place(str(path))
        self._view, self._size = view, size
        self._pictures: list[Any] = []

    def __len__(self) -> int:
        return len(self._pictures)

    def add(self, marks: Iterable[Mark], title: str, *, trail: Iterable[tuple[float, float]] = ()) -> None:
        """Add a picture, with lines below it, and a robot's trail on it.

        Raises:
            MapError: If Pillow is not installed.
        """
        self._pictures.append(self._view.image(marks, trail=trail, title=title, size=self._size))

    def save(self, seconds: float) -> None:
        """Write the film; an animation shows each picture for so many seconds.

        Raises:
            Error: If there is no picture, or the file cannot be written.
        """
        if not self._pictures:
            raise Error(f"{self.path}: there is no picture to make a film of")
        with replacing(self.path) as file:
            if self.path.suffix.lower() == ".png":
                self._sheet().save(file, format="PNG", optimize=True)
                return
            high = max(picture.height for picture in self._pictures)
            first, *rest = (self._filled(picture, high).convert("P", palette=1) for picture in self._pictures)
            milliseconds = max(20, round(1000 * seconds))
            first.save(file, format="GIF", save_all=True, append_images=rest, duration=milliseconds, loop=0)

    def _filled(self, picture: Any, high: int) -> Any:
        from PIL import Image  # noqa: PLC0415 - an extra

        whole = Image.new("RGB", (picture.width, high), "white")
        whole.paste(picture, (0, 0))
        return whole

    def _sheet(self) -> Any:
        from PIL import Image  # noqa: PLC0415 - an extra

        count = min(_SHEET, len(self._pictures))
        last = len(self._pictures) - 1
        chosen = [self._pictures[round(index * last / max(1, count - 1))] for index in range(count)]
        across = math.ceil(math.sqrt(count))
        wide, high = max(one.width for one in chosen) + _GAP, max(one.height for one in chosen) + _GAP
        sheet = Image.new("RGB", (across * wide - _GAP, math.ceil(count / across) * high - _GAP), "white")
        for index, picture in enumerate(chosen):
            sheet.paste(picture, (index % across * wide, index // across * high))
        return sheet


def _runs(inside: NDArray[np.bool_]) -> Iterator[tuple[int, int, int]]:
    """Yield the row, the first column and the one after the last of each stretch inside."""
    for row, line in enumerate(inside):
        edges = np.flatnonzero(np.diff(np.concatenate(([0], line.astype(np.int8), [0]))))
        for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            yield row, first, last


def _thin(walls: NDArray[np.float64], between: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return in which blocks a wall is drawn that is too thin for either of the two, one below the other, it lies in.

    Args:
        walls: The share of each block that is a wall.
        between: The same of blocks that begin half a block further down.
    """
    across = (between[:-1] > _WALLED) & (np.maximum(walls[:-1], walls[1:]) <= _WALLED)
    is_upper = walls[:-1] >= walls[1:]
    thin = np.zeros(walls.shape, dtype=bool)
    thin[:-1] |= across & is_upper
    thin[1:] |= across & ~is_upper
    return thin


def _outside(raster: NDArray[np.uint16], thick: float) -> NDArray[np.bool_]:
    """Return which cells lie behind the walls: around all, or in a hollow; furniture within a place does not."""
    empty: NDArray[np.bool_] = raster == 0
    parts, _ = scipy.ndimage.label(np.pad(empty, 1, constant_values=True))
    around: NDArray[np.bool_] = parts[1:-1, 1:-1] == parts[0, 0]
    behind: NDArray[np.bool_] = scipy.ndimage.distance_transform_edt(empty) > thick
    return around & behind


def _coloured(
    line: Sequence[str], labels: NDArray[np.int64], inks: dict[int, tuple[Ink, bool]], palette: Palette
) -> str:
    """Return a line of signs with the colours of the upper and the lower half of each."""
    parts: list[str] = []
    last = ""
    for column, sign in enumerate(line):
        upper, lower = (_tint(label) for label in labels[:, column].tolist())
        ink = inks.get(column)
        shown = sign
        if sign == " " and upper is None and lower is not None:
            code, shown = f"\x1b[22m{palette.front(lower)}{palette.back(None)}", "▄"
        elif sign == " " and upper == lower:
            code = f"\x1b[22m{palette.back(upper)}"
        elif sign == " ":
            code, shown = f"\x1b[22m{palette.front(upper)}{palette.back(lower)}", "▀"
        elif ink is None:
            code = f"\x1b[22m{palette.front(_BLACK)}{palette.back(upper)}"
        elif ink[1]:
            code = f"\x1b[1m{palette.front(_WHITE)}{palette.back(ink[0])}"
        else:
            code = f"\x1b[1m{palette.front(ink[0])}{palette.back(upper)}"
        parts.append(shown if code == last else code + shown)
        last = code
    return "".join(parts) + "\x1b[0m"


@cache
def _tint(label: int) -> Ink | None:
    if label == _OUTSIDE:
        return None
    if label == 0:
        return _WALL
    red, green, blue = (round(255 - _TINT * (255 - part)) for part in colour(label - 1))
    return red, green, blue
