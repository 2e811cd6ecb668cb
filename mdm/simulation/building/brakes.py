"""Brakes: how much of what a robot is about to drive in a step it may, so that it touches nothing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.paths import WALL_GAP

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.maps.raster import Grid
    from mdm.simulation.building.body import Body

__all__ = ["GAP", "Brakes"]

GAP = 2 * WALL_GAP
"""Metres that are left between two bodies."""
_PAST = 0.01
"""Of what is driven, what may lead nearer to a body that is passed."""
_BEYOND = 64
"""Cells of wall beyond the grid."""
_SHARES = (0.5, 0.25, 0.0)
"""Of what would be driven: what is tried where all of it would lead too near to a wall."""


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
            body: What drives.
            forward: The metres that it is about to drive straight on; backwards where they are negative.
            turn: The radians that it turns by meanwhile.
            others: What may be in its way.
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
