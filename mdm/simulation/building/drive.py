"""A drive that is under way, and a stay aside: what a simulated robot keeps in mind."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.maps import Pose
    from mdm.maps.paths import Paths
    from mdm.models.matrices import Vector
    from mdm.simulation.building.body import Body

    Cell = tuple[int, int]

__all__ = ["Aside", "Drive"]

_PASSED, _ASIDE = 2.0, 15.0
"""Metres that the others have driven on, and seconds, after which a robot that gave way goes on."""


class Drive:
    """A drive that is under way."""

    def __init__(self, goal: Pose, paths: Paths, distances: Vector, remaining: float) -> None:
        self.goal = goal
        self.paths = paths  # over which its way leads: around bodies that stand in it, by and by
        self.distances = distances
        self.turns: list[tuple[int, int]] = []
        self.remaining = remaining
        self.waited = 0.0
        self.blocked = 0.0
        self.again = 0.0  # of the seconds that it waited, when it looks again for a way around
        self.looks = 0
        self.stuck = 0.0  # seconds since it last moved at all
        self.free: tuple[float, float] | None = None  # where it drives to get away from a wall, and how long
        self.freeing = 0.0
        self.way_out: list[tuple[float, float]] = []  # the same where nobody drives near it
        self.held = 0.0  # seconds since it was at the next, with less than a little way from there
        self.careful = 0.0  # seconds for which it follows its way itself, and the cell to which it drives then
        self.step: Cell | None = None
        self.still, self.there = 0.0, math.inf  # seconds since it was so many metres from its goal, or nearly
        self.at = (math.inf, math.inf)
        self.around: frozenset[Cell] = frozenset()  # where bodies stand that its way leads around
        self.over: asyncio.Future[None] = asyncio.get_running_loop().create_future()


class Aside:
    """A robot's stay out of the way of others.

    Args:
        turns: The cells on the way there.
        others: Those that are to pass.
    """

    def __init__(self, turns: list[tuple[int, int]], others: Sequence[Body]) -> None:
        self.turns = turns
        self.seconds = 0.0
        self._others = [(body, body.remaining) for body in others]

    def is_over(self) -> bool:
        """Whether all others have driven on or do not drive any more, or it has taken long enough."""
        passed = all(not body.turns or abs(body.remaining - before) > _PASSED for body, before in self._others)
        return passed or self.seconds > _ASIDE
