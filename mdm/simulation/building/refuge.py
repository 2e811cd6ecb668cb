"""Room: where a robot is out of the way of others, how one that hardly has room gets to where it has, and brakes.

Brakes tell how much of its way in a step a robot may drive, so that it touches nothing.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.paths import WALL_GAP, Paths

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from mdm.maps import Grid
    from mdm.simulation.building.body import Body

    Cell = tuple[int, int]
    Point = tuple[float, float]

_REACH = 8.0
"""Metres around a robot where a refuge is looked for."""
_BESIDE = 0.4
"""Metres between a robot in its refuge and one that passes."""
_HAIR = 0.003
"""Metres to spare from others on the way, beside those that the brakes leave."""
_FIELD = 1.5
"""Metres from the robot within which it is looked for."""
_FIRST = 2.5
"""Sides of a cell to which the first step leads at most."""
_DIRECTIONS = 64
"""In which a straight way out is looked for."""


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


def way_out(
    here: Point, radius: float, grid: Grid, others: Sequence[Body], ample: Sequence[tuple[NDArray[np.bool_], float]]
) -> list[Point]:
    """Return the points of a way from where a robot stands, straight from one to the next; empty where there is none.

    Wherever it leads, the brakes let the robot pass: nothing is touched, and it leads away from bodies
    that are nearer than they let it come.

    Args:
        here: Where the robot stands.
        radius: The robot's.
        grid: Where walls are.
        others: Bodies that may be in its way; where they are now counts.
        ample: Where it has room, the best first: cells, and the metres that it is to be away from others there.
    """
    frame = grid.frame
    near = [one for one in others if math.dist(here, one.agent.position) < _FIELD + radius + one.radius]
    past_walls = grid.clearance_to_edges() >= radius + WALL_GAP
    away = np.full(frame.shape, math.inf)
    rows, columns = np.indices(frame.shape)
    for one in near:
        row, column = frame.locate(one.pose.x, one.pose.y)
        apart = np.hypot(rows - row, columns - column) * frame.resolution - radius - one.radius
        away = np.minimum(away, apart)
    row, column = frame.locate(*here)
    metres = np.hypot(rows - row, columns - column) * frame.resolution
    fits = past_walls & (away >= GAP + _HAIR) & (metres < _FIELD)
    begins = np.argwhere(fits & (metres < _FIRST * frame.resolution))
    begins = begins[metres[tuple(begins.T)].argsort(kind="stable")]
    first = [(int(r), int(c)) for r, c in begins if _leads(here, frame.centre(int(r), int(c)), radius, near)]
    for cells, room in ample:
        found = _search(first, fits, cells & (away > room))
        if found:
            return [frame.centre(*cell) for cell in found]
    # Between two that hardly leave room, no cell's centre may be on the way, which is a straight line then.
    for cells, room in ample:
        line = _straight(here, radius, grid, near, past_walls, cells, room)
        if line is not None:
            return [line]
    return []


def _straight(
    here: Point,
    radius: float,
    grid: Grid,
    near: Sequence[Body],
    fits: NDArray[np.bool_],
    ample: NDArray[np.bool_],
    room: float,
) -> Point | None:
    """Return the nearest point with so much room, straight on in some direction; None where there is none."""
    side = grid.frame.resolution
    blocked: set[float] = set()
    for metres in np.arange(side, _FIELD, side).tolist():
        for angle in np.linspace(0.0, math.tau, _DIRECTIONS, endpoint=False).tolist():
            there = here[0] + metres * math.cos(angle), here[1] + metres * math.sin(angle)
            cell = grid.frame.cell(*there)
            if angle in blocked or cell is None or not fits[cell] or not _leads(here, there, radius, near):
                blocked.add(angle)
            elif ample[cell] and all(math.dist(there, one.agent.position) > radius + one.radius + room for one in near):
                return there
    return None


def _leads(here: Point, there: Point, radius: float, near: Sequence[Body]) -> bool:
    """Whether a straight step leads past others, or away from them."""
    (x, y), ahead = here, np.subtract(there, here)
    length = float(np.hypot(*ahead))
    for one in near:
        other = np.subtract(one.agent.position, (x, y))
        along = float(ahead @ other) / length if length else 0.0
        if along > 0:
            nearest = math.dist(np.multiply(ahead, min(1.0, along / length)), other)
            if nearest < radius + one.radius + GAP + _HAIR:
                return False
    return True


def _search(first: Sequence[Cell], fits: NDArray[np.bool_], ample: NDArray[np.bool_]) -> list[Cell]:
    """Return the cells of a way with the fewest steps from one of the first to where there is room."""
    before: dict[Cell, Cell | None] = dict.fromkeys(first)
    waiting = deque(first)
    rows, columns = fits.shape
    while waiting:
        cell = waiting.popleft()
        if ample[cell]:
            way: list[Cell] = []
            step: Cell | None = cell
            while step is not None:
                way.append(step)
                step = before[step]
            return way[::-1]
        row, column = cell
        for below in range(max(0, row - 1), min(rows, row + 2)):
            for beside in range(max(0, column - 1), min(columns, column + 2)):
                if fits[below, beside] and fits[row, beside] and fits[below, column] and (below, beside) not in before:
                    before[below, beside] = cell
                    waiting.append((below, beside))
    return []


# -- Brakes ------------------------------------------------------------------------------------------------------------

GAP = 2 * WALL_GAP
"""Metres that are left between two bodies."""
_PAST = 0.01
"""The share of a way that may lead nearer to a body that is passed."""
_BEYOND = 64
"""Cells of wall beyond the grid."""
_SHARES = (0.5, 0.25, 0.0)
"""Shares of a way that are tried where all of it would lead too near to a wall."""


class Brakes:
    """Keeps bodies apart, whatever steers them: none drives farther in a step than half of the room up to another.

    Args:
        grid: Where walls are; beyond it, all is wall.
    """

    def __init__(self, grid: Grid) -> None:
        self._frame = grid.frame
        self._walls = np.pad(~grid.free, _BEYOND, constant_values=True)
        self._clearance = grid.clearance()

    def share(self, body: Body, forward: float, turn: float, others: Iterable[Body]) -> float:
        """Return which share of its way a body may drive, from 0 to 1.

        Args:
            body: The one that drives.
            forward: The metres that it is about to drive straight on; backwards where they are negative.
            turn: The radians that it turns by meanwhile.
            others: Those that may be in its way.
        """
        if not forward:
            return 1.0
        here = body.pose
        heading = here.yaw if forward > 0 else here.yaw + math.pi
        share, metres = 1.0, abs(forward)
        for other in others:
            if other is body:
                continue
            x, y = other.agent.position.tolist()
            room = math.hypot(x - here.x, y - here.y) - body.radius - other.radius - GAP
            if room > 2 * metres:
                continue
            off = abs(math.remainder(math.atan2(y - here.y, x - here.x) - heading, math.tau))
            nearer = metres * math.cos(max(0.0, off - abs(turn)))
            if nearer > max(room / 2, _PAST * metres):
                share = min(share, max(room, 0.0) / 2 / nearer)
        if share == 0.0:
            return share
        # It drives an arc, whose chord lies half of the turn aside.
        chord = metres * float(np.sinc(turn / math.tau))
        return self._before_walls(here.x, here.y, heading + turn / 2, share, chord, body.radius)

    def _before_walls(self, x: float, y: float, heading: float, share: float, metres: float, radius: float) -> float:
        """Return the share that ends far enough from walls, or not nearer to them than now."""
        side = self._frame.resolution
        needed, cell = radius + WALL_GAP, self._frame.cell(x, y)
        # It is off its cell's centre by half a diagonal at most, and so is the corner of a wall off its own.
        if cell is None or self._clearance[cell] > needed + metres + math.sqrt(2) * side:
            return share
        here = np.array(self._frame.locate(x, y))
        along = heading - self._frame.yaw
        ahead = np.array([-math.sin(along), math.cos(along)]) * metres / side
        around = math.ceil((needed + metres) / side) + 1
        low = np.array(cell) + _BEYOND - around
        window = self._walls[low[0] : low[0] + 2 * around + 1, low[1] : low[1] + 2 * around + 1]
        walls = np.argwhere(window) + low - _BEYOND

        def clearance(part: float) -> float:
            away = np.maximum(np.abs(walls - (here + part * ahead)) - 0.5, 0.0)
            return side * math.sqrt(float((away * away).sum(axis=1).min(initial=math.inf)))

        now = clearance(0.0)
        for part in (share, *(each * share for each in _SHARES)):
            if (then := clearance(part)) >= needed or then >= now:
                return part
        return 0.0
