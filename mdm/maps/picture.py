"""Pictures of maps: places in colours, goals as arrows, ways and passages; drawn with Pillow (`mdm[maps]`)."""

from __future__ import annotations

import colorsys
import math
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mdm.errors import MapError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from mdm.maps.graph import Graph, Node, Pose
    from mdm.maps.paths import Passage
    from mdm.maps.raster import Frame, Grid, Labels

_FREE, _UNKNOWN, _OCCUPIED = (252, 252, 250), (226, 227, 230), (58, 62, 72)
_INK, _PAPER, _MARK = (30, 33, 40), (255, 255, 255), (214, 30, 60)
_BLACK = (0, 0, 0)
_BORDER, _WIDTH = (255, 205, 40), (255, 243, 196)
_TINT, _SHADE = 0.42, 0.10
"""How much of a place's colour is on free cells, and on others."""
_SMOOTH = 2
"""Everything is drawn so many times as large, and made smaller at the end."""
_LEAST = 3
"""The rank of texts that may be left out."""
_LINE = (150, 160, 185)
_LINES = 90
"""Pixels between the lines of the coordinates, at least."""
_MOST = 24
"""Pixels of a cell."""

Window: TypeAlias = tuple[int, int, int, int]
"""The first row and column, and those after the last."""
Point: TypeAlias = tuple[float, float]
Box: TypeAlias = tuple[float, float, float, float]
Ink: TypeAlias = tuple[int, int, int]
"""Red, green and blue, up to 255."""


def colour(index: int) -> Ink:
    """Return a colour for the place of an index, unlike those of the indices near it."""
    red, green, blue = colorsys.hls_to_rgb((0.58 + 0.618034 * index) % 1, 0.47 - 0.06 * (index % 3 - 1), 0.62)
    return round(255 * red), round(255 * green), round(255 * blue)


def contrast(ink: Ink, other: Ink) -> float:
    """Return the contrast of two colours, as WCAG 2.2 measures it: from 1 to 21; text should have 4.5."""
    low, high = sorted((_luminance(ink), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


def around(frame: Frame, cells: Iterable[tuple[float, float]], metres: float) -> Window:
    """Return the part of a raster that holds cells, with so much around them; the whole where there are none."""
    rows, columns = np.array(list(cells) or [(0, 0), (frame.rows, frame.columns)]).T
    wide = metres / frame.resolution
    top, left = max(math.floor(rows.min() - wide), 0), max(math.floor(columns.min() - wide), 0)
    bottom, right = math.ceil(rows.max() + wide) + 1, math.ceil(columns.max() + wide) + 1
    top, left = min(top, frame.rows - 1), min(left, frame.columns - 1)
    return top, left, max(min(bottom, frame.rows), top + 1), max(min(right, frame.columns), left + 1)


class Picture:
    """A picture of a part of a map.

    Args:
        labels: The places.
        grid: Which cells are free; None for all that have a place.
        window: The part of the raster.
        size: How long the longer side should be, in pixels.

    Raises:
        MapError: If Pillow is not installed.
    """

    def __init__(self, labels: Labels, grid: Grid | None, window: Window, *, size: int = 1200) -> None:
        image, draw, font = _pillow()
        top, left, bottom, right = window
        self.frame = labels.frame
        self._names = labels.names
        self._corner = top, left
        self._cell = min(max(round(size / max(bottom - top, right - left)), 1), _MOST) * _SMOOTH
        cells = _painted(labels, grid)[top:bottom, left:right]
        self._image = image.fromarray(cells).resize(
            ((right - left) * self._cell, (bottom - top) * self._cell), image.Resampling.NEAREST
        )
        self._draw = draw.Draw(self._image)
        self._unit = _SMOOTH * max(1.0, min(self._image.size) / _SMOOTH / 900)
        """So many pixels are one of a picture of usual size."""
        self._font = font.load_default(round(13 * self._unit))
        self._taken: list[Box] = []
        self._texts: list[tuple[int, str, Point, Ink]] = []
        self._marks: list[tuple[Pose, float, Ink, str]] = []

    def passage(self, passage: Passage, *, told: bool = True) -> None:
        """Draw a passage: its border, and, if that is to be told, how wide it is."""
        self._fill(passage.cells.tolist(), _BORDER)
        if told:
            self._write(f"{passage.width:.2f} m", self._at(*passage.middle), fill=_WIDTH, rank=_LEAST)

    def graph(self, graph: Graph, routes: Mapping[frozenset[str], Sequence[tuple[int, int]]]) -> None:
        """Draw the goals of a graph, and its ways as arrows with their labels.

        Args:
            graph: The graph.
            routes: For two places the cells where the way between them turns, from the goal of either to the other's;
                where there is none a way is drawn straight.
        """
        places = {node.name: self._place(node.goal) for node in graph.nodes}
        for x, y in places.values():
            self._take(x, y, 11, 11)
        for edge in graph.edges:
            start, end = places[edge.source], places[edge.target]
            between = [self._at(*cell) for cell in routes.get(frozenset((edge.source, edge.target)), ())][1:-1]
            if len(between) > 1 and math.dist(start, between[0]) > math.dist(start, between[-1]):
                between.reverse()
            line = self._line(start, between, end)
            self._arrow(line)
            if edge.label != f"to {edge.target}":  # which the arrow says
                passed = list(accumulate(math.dist(one, other) for one, other in pairwise(line)))
                place = next(index for index, length in enumerate(passed) if length >= 0.3 * passed[-1])
                self._write(edge.label, line[place], fill=_PAPER, rank=1)
        for node in graph.nodes:
            self._goal(node)
            x, y = places[node.name]
            self._write(node.name, (x, y + 22 * self._unit), fill=self._of(node.name), rank=0)

    def note(self, goal: Pose, text: str) -> None:
        """Write a text above a goal."""
        x, y = self._place(goal)
        self._write(text, (x, y - 22 * self._unit), fill=_WIDTH, rank=0)

    def shade(self, cells: Sequence[tuple[int, int]]) -> None:
        """Fill cells with the colour of problems."""
        self._fill(cells, _MARK)

    def ring(self, cells: Sequence[tuple[int, int]]) -> None:
        """Draw rings around cells."""
        # No two rings are near each other, and all other cells are near one.
        distance = 30 * self._unit / self._cell
        chosen: list[tuple[int, int]] = []
        for cell in cells:
            if all(math.dist(cell, other) > distance for other in chosen):
                chosen.append(cell)
        for row, column in chosen:
            x, y = self._at(row, column)
            for radius, width, ink in ((24, 7, _PAPER), (23, 4, _MARK)):
                self._ring(x, y, radius * self._unit, round(width * self._unit), ink)

    def name(self, node: Node) -> None:
        """Write the name of a place at its goal."""
        self._write(node.name, self._place(node.goal), fill=self._of(node.name), rank=0)

    def mark(self, pose: Pose, radius: float, ink: Ink, letter: str = "") -> None:
        """Put a disc of a radius in metres at a pose, above all else: with a letter, or a nose that points ahead."""
        self._marks.append((pose, radius, ink, letter))

    def trail(self, points: Sequence[Point], ink: Ink) -> None:
        """Draw a line through points, given in metres."""
        line = [self._at(*self.frame.locate(*point)) for point in points]
        if len(line) > 1:
            self._draw.line(line, fill=ink, width=round(3 * self._unit), joint="curve")

    def _disc(self, pose: Pose, radius: float, ink: Ink, letter: str) -> None:
        x, y = self._place(pose)
        size = max(radius / self.frame.resolution * self._cell, 9 * self._unit)
        for wide, fill in ((size + 2 * self._unit, _PAPER), (size, ink)):
            self._draw.ellipse((x - wide, y - wide, x + wide, y + wide), fill=fill)
        if letter:
            self._draw.text((x, y), letter, font=self._font, fill=_PAPER, anchor="mm")
        else:
            yaw = pose.yaw - self.frame.yaw
            nose = x + size * math.cos(yaw), y - size * math.sin(yaw)
            self._draw.line(((x, y), nose), fill=_PAPER, width=round(3 * self._unit))

    def circle(self, pose: Pose, radius: float) -> None:
        """Draw a circle of a radius in metres around a pose, such as a robot."""
        x, y = self._place(pose)
        self._ring(x, y, radius / self.frame.resolution * self._cell, round(2 * self._unit), _MARK)

    def scale(self) -> None:
        """Draw a bar of a round length in a corner."""
        per_metre = self._cell / self.frame.resolution
        length = next(
            (metres for metres in (50, 20, 10, 5, 2, 1, 0.5, 0.2) if metres * per_metre < self._image.width / 4), 0.1
        )
        margin, unit = 14 * self._unit, self._unit
        x, y = margin, self._image.height - margin
        self._draw.rectangle((x, y - 5 * unit, x + length * per_metre, y), fill=_INK, outline=_PAPER, width=round(unit))
        self._write(f"{length:g} m", (x + length * per_metre / 2, y - 18 * unit), fill=_PAPER, rank=2)

    def coordinates(self) -> None:
        """Draw lines of equal x and of equal y, at round metres, with their numbers at both ends."""
        least = _LINES * self._unit / self._cell * self.frame.resolution
        step = next(
            metres * 10**power for power in range(-2, 9) for metres in (1, 2, 5) if metres * 10.0**power >= least
        )
        wide, high = self._image.width / self._cell, self._image.height / self._cell
        ends = [
            (self._corner[0] + down * high - 0.5, self._corner[1] + right * wide - 0.5)
            for down in (0, 1)
            for right in (0, 1)
        ]
        around = np.array([self.frame.centre(*end) for end in ends])
        low, most = around.min(axis=0), around.max(axis=0)
        for axis, name in enumerate("xy"):
            for number in range(math.ceil(low[axis] / step), math.floor(most[axis] / step) + 1):
                line = [np.array(point) for point in (low, most)]
                for point in line:
                    point[axis] = number * step
                seen = self._within(*(self._at(*self.frame.locate(*point)) for point in line))
                if seen is None:
                    continue
                self._draw.line(seen, fill=_LINE, width=max(round((2 if number == 0 else 0.8) * self._unit), 1))
                for place in seen:
                    self._write(f"{name} {number * step:g}", place, fill=_PAPER, rank=2)

    def _within(self, start: Point, end: Point) -> tuple[Point, Point] | None:
        """Return the part of a line that is in the picture, after Liang and Barsky; None where it is outside."""
        first, last = 0.0, 1.0
        for axis, size in enumerate(self._image.size):
            along = end[axis] - start[axis]
            for away, room in ((-along, start[axis]), (along, size - 1 - start[axis])):
                if away == 0 and room < 0:
                    return None
                if away < 0:
                    first = max(first, room / away)
                elif away > 0:
                    last = min(last, room / away)
        if first >= last:
            return None
        across, down = end[0] - start[0], end[1] - start[1]
        one, other = ((start[0] + part * across, start[1] + part * down) for part in (first, last))
        return one, other

    def finished(self, title: str = "") -> Any:
        """Return the picture, as an image of Pillow's, with the lines of a title below it."""
        image, _, _ = _pillow()
        for rank, text, at, fill in sorted(self._texts, key=lambda each: each[0]):
            self._text(text, at, fill, needed=rank != _LEAST)
        for pose, radius, ink, letter in self._marks:
            self._disc(pose, radius, ink, letter)
        whole = self._titled(title) if title else self._image
        wide, high = whole.size
        return whole.resize((max(wide // _SMOOTH, 1), max(high // _SMOOTH, 1)), image.Resampling.LANCZOS)

    def _titled(self, text: str) -> Any:
        image, draw, _ = _pillow()
        lines: list[str] = []
        for written in text.splitlines():
            lines.append("")
            for word in written.split():
                longer = f"{lines[-1]} {word}".strip()
                if lines[-1] and self._font.getlength(longer) > self._image.width - 20 * self._unit:
                    lines.append(word)
                else:
                    lines[-1] = longer
        high = round(20 * self._unit)
        whole = image.new("RGB", (self._image.width, self._image.height + high * len(lines) + high // 2), _PAPER)
        whole.paste(self._image, (0, 0))
        pen = draw.Draw(whole)
        for number, line in enumerate(lines):
            at = (10 * self._unit, self._image.height + high * number + high // 3)
            pen.text(at, line, font=self._font, fill=_INK)
        return whole

    def _at(self, row: float, column: float) -> Point:
        return (column - self._corner[1] + 0.5) * self._cell, (row - self._corner[0] + 0.5) * self._cell

    def _place(self, pose: Pose) -> Point:
        return self._at(*self.frame.locate(pose.x, pose.y))

    def _of(self, name: str) -> Ink:
        return colour(self._names.index(name)) if name in self._names else (110, 110, 110)

    def _fill(self, cells: Iterable[Sequence[int]], ink: Ink) -> None:
        half = self._cell / 2
        for row, column in cells:
            x, y = self._at(row, column)
            self._draw.rectangle((x - half, y - half, x + half, y + half), fill=ink)

    def _ring(self, x: float, y: float, radius: float, width: int, ink: Ink) -> None:
        self._draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=ink, width=width)

    def _goal(self, node: Node) -> None:
        x, y = self._place(node.goal)
        yaw = node.goal.yaw - self.frame.yaw
        ahead, aside = (math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw))

        def shape(size: float) -> list[tuple[float, float]]:
            corners = ((1.25, 0.0), (-0.85, 0.8), (-0.4, 0.0), (-0.85, -0.8))
            return [
                (x + size * (a * ahead[0] + b * aside[0]), y + size * (a * ahead[1] + b * aside[1])) for a, b in corners
            ]

        self._draw.polygon(shape(14 * self._unit), fill=_PAPER)
        self._draw.polygon(shape(10.5 * self._unit), fill=self._of(node.name))

    def _line(self, start: Point, between: Sequence[Point], end: Point) -> list[Point]:
        """Return the points of a line to the right of that through some points, short of both ends, with soft turns."""
        if start == end:
            start, end = (start[0] - 24 * self._unit, start[1]), (end[0] + 24 * self._unit, end[1])
            between = [((start[0] + end[0]) / 2, start[1] - 60 * self._unit)]
        corners = [start, *(point for point in between if point not in {start, end}), end]
        first, last = _towards(corners[0], corners[1]), _towards(corners[-2], corners[-1])
        gap = min(18 * self._unit, math.dist(start, end) / 3)
        corners[0] = start[0] + gap * first[0], start[1] + gap * first[1]
        corners[-1] = end[0] - gap * last[0], end[1] - gap * last[1]
        # The line runs on its right.
        distance = 5 * self._unit
        ahead = [_towards(one, other) for one, other in pairwise(corners)]
        turns = [ahead[0], *(_towards((0, 0), (a[0] + b[0], a[1] + b[1])) for a, b in pairwise(ahead)), ahead[-1]]
        corners = [_beside(corner, direction, distance) for corner, direction in zip(corners, turns, strict=True)]
        line = [corners[0]]
        for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
            smooth = min(math.dist(before, corner), math.dist(corner, after), 60 * self._unit) / 2
            come, go = _towards(before, corner), _towards(corner, after)
            one = corner[0] - smooth * come[0], corner[1] - smooth * come[1]
            other = corner[0] + smooth * go[0], corner[1] + smooth * go[1]
            line += [_curve(one, corner, other, step / 12) for step in range(13)]
        straight = line[-1], corners[-1]
        return [*line, *(_curve(straight[0], straight[0], straight[1], step / 12) for step in range(1, 13))]

    def _arrow(self, line: list[Point]) -> None:
        tip, unit = line[-1], self._unit
        ahead = _towards(line[-4], tip)
        back = tip[0] - 9 * unit * ahead[0], tip[1] - 9 * unit * ahead[1]
        for width, size, ink in ((5, 1.5, _PAPER), (2.2, 1.0, _INK)):
            shaft = [point for point in line if math.dist(point, tip) > 6 * unit]
            self._draw.line([*shaft, back], fill=ink, width=round(width * unit), joint="curve")
            wing = 4.6 * size * unit
            point = tip[0] + (size - 1) * 5 * unit * ahead[0], tip[1] + (size - 1) * 5 * unit * ahead[1]
            behind = back[0] - (size - 1) * 4 * unit * ahead[0], back[1] - (size - 1) * 4 * unit * ahead[1]
            self._draw.polygon([point, _beside(behind, ahead, wing), _beside(behind, ahead, -wing)], fill=ink)
        self._take(*tip, 6, 6)

    def _take(self, x: float, y: float, wide: float, high: float) -> None:
        wide, high = wide * self._unit, high * self._unit
        self._taken.append((x - wide, y - high, x + wide, y + high))

    def _write(self, text: str, at: Point, *, fill: Ink, rank: int) -> None:
        """Note a text in the picture; the lower its rank, the earlier it is written and finds a free place."""
        if 0 <= at[0] < self._image.width and 0 <= at[1] < self._image.height:
            self._texts.append((rank, text, at, fill))

    def _text(self, text: str, at: Point, fill: Ink, *, needed: bool) -> None:
        """Write a text, black or white, on a plate about a point, or beside it where something is written already.

        Where no place is free, a needed text is written over others, and another one is left out.
        """
        wide, high = self._font.getlength(text) / 2 + 6 * self._unit, 10.5 * self._unit
        steps = [(0.0, 0.0)] + [
            (across * (wide + high) * near, down * 2.1 * high * near)
            for near in (0.6, 1, 1.6, 2.4)
            for across, down in ((0, -1), (0, 1), (1, 0), (-1, 0), (0.7, -1), (-0.7, 1), (0.7, 1), (-0.7, -1))
        ]
        boxes = [self._box(at[0] + across, at[1] + down, wide, high) for across, down in steps]
        taken = np.array(self._taken).reshape(-1, 4)
        box = next(
            (each for each in boxes if not ((taken[:, :2] < each[2:]) & (taken[:, 2:] > each[:2])).all(axis=1).any()),
            None,
        )
        if box is None:
            if not needed:
                return
            box = boxes[0]
        self._taken.append(box)
        self._draw.rounded_rectangle(box, radius=6 * self._unit, fill=fill, outline=_PAPER, width=round(self._unit))
        ink = max(_BLACK, _PAPER, key=lambda one: contrast(one, fill))
        self._draw.text(((box[0] + box[2]) / 2, (box[1] + box[3]) / 2), text, font=self._font, fill=ink, anchor="mm")

    def _box(self, x: float, y: float, wide: float, high: float) -> Box:
        """Return a box about a point, moved into the picture."""
        x = min(max(x, wide), max(self._image.width - wide, wide))
        y = min(max(y, high), max(self._image.height - high, high))
        return x - wide, y - high, x + wide, y + high


def stacked(pictures: Sequence[tuple[str, Any]]) -> Any:
    """Return finished pictures one below the other, each below its title."""
    image, draw, font = _pillow()
    high, letters = 34, font.load_default(20)
    width = max(picture.width for _, picture in pictures)
    whole = image.new("RGB", (width, sum(high + picture.height for _, picture in pictures)), _PAPER)
    pen, top = draw.Draw(whole), 0
    for title, picture in pictures:
        pen.text((10, top + high / 2), title, font=letters, fill=_INK, anchor="lm")
        whole.paste(picture, (0, top + high))
        top += high + picture.height
    return whole


def _painted(labels: Labels, grid: Grid | None) -> NDArray[np.uint8]:
    """Return the colours of all cells."""
    cells = np.empty((*labels.frame.shape, 3), dtype=np.float64)
    cells[:] = _UNKNOWN
    free = labels.raster > 0 if grid is None else grid.free
    cells[free] = _FREE
    if grid is not None:
        cells[grid.occupied] = _OCCUPIED
    colours = np.array([(0, 0, 0), *(colour(index) for index in range(len(labels.names)))], dtype=np.float64)
    share = np.where(free, _TINT, _SHADE) * (labels.raster > 0)
    cells += share[:, :, None] * (colours[labels.raster] - cells)
    painted: NDArray[np.uint8] = cells.round().astype(np.uint8)
    return painted


def _luminance(ink: Ink) -> float:
    parts = (part / 255 for part in ink)
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _curve(start: Point, bend: Point, end: Point, part: float) -> Point:
    """Return a point of a quadratic curve."""
    a, b, c = (1 - part) ** 2, 2 * part * (1 - part), part**2
    return a * start[0] + b * bend[0] + c * end[0], a * start[1] + b * bend[1] + c * end[1]


def _towards(start: Point, end: Point) -> Point:
    """Return the direction from a point to another one."""
    length = math.dist(start, end) or 1.0
    return (end[0] - start[0]) / length, (end[1] - start[1]) / length


def _beside(point: Point, direction: Point, distance: float) -> Point:
    """Return a point to the right of another one, as one looks in a direction."""
    return point[0] - direction[1] * distance, point[1] + direction[0] * distance


def _pillow() -> tuple[Any, Any, Any]:
    try:
        from PIL import Image, ImageDraw, ImageFont  # noqa: PLC0415 - an extra
    except ImportError:
        raise MapError("pictures of maps need Pillow: pip install pillow pyyaml") from None
    return Image, ImageDraw, ImageFont
