"""Bodies: something round that moves on the floor of a building, between walls."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.maps import Pose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.maps import Grid
    from mdm.maps.paths import Paths

    Cell = tuple[int, int]

__all__ = ["Body", "walls"]


class Body(ABC):
    """A robot, as others see it: where it is, and where it drives.

    Args:
        name: Its name.
        agent: What stands for it in navground.
        paths: Where it may be.
    """

    def __init__(self, name: str, agent: Any, paths: Paths) -> None:
        self.name = name
        self.radius = float(agent.radius)
        self.agent = agent
        self._paths = paths

    @property
    def pose(self) -> Pose:
        """Where it really is."""
        (x, y), yaw = self.agent.position, self.agent.orientation
        return Pose(float(x), float(y), float(yaw))

    @property
    def cell(self) -> Cell:
        """The nearest cell that it may be in: pushed against a wall it can be in another."""
        here = self.pose
        cell = self._paths.frame.cell(here.x, here.y)
        if cell is not None and self._paths.open[cell]:
            return cell
        row, column = cell if cell is not None else (0, 0)
        cells = np.argwhere(self._paths.open)
        nearest = cells[np.hypot(cells[:, 0] - row, cells[:, 1] - column).argmin()]
        return int(nearest[0]), int(nearest[1])

    @property
    @abstractmethod
    def remaining(self) -> float:
        """The metres to go; 0 where it stands."""

    @property
    @abstractmethod
    def turns(self) -> tuple[Cell, ...]:
        """The cells where its way turns, and its end; none where it stands, or lets others pass."""

    @abstractmethod
    def steer(self, seconds: float, bodies: Sequence[Body] = ()) -> None:
        """Set out, before a step of the building.

        Args:
            seconds: Since the last step.
            bodies: All that are in the building; of two in each other's way the later one gives way first.
        """


Point = tuple[float, float]


def walls(grid: Grid) -> list[tuple[Point, Point]]:
    """Return the ends of all walls, in metres. What lies beyond the grid is a wall."""
    found = []
    padded = np.pad(grid.free, 1)
    for upright in (False, True):
        cells = padded.T if upright else padded
        borders = cells[1:] != cells[:-1]
        ends = np.diff(np.pad(borders, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        for line in np.flatnonzero(borders.any(axis=1)):
            for begin, end in np.flatnonzero(ends[line]).reshape(-1, 2).tolist():
                corners = [(float(line) - 0.5, begin - 1.5), (float(line) - 0.5, end - 1.5)]
                first, last = (corner[::-1] for corner in corners) if upright else corners
                found.append((grid.frame.centre(*first), grid.frame.centre(*last)))
    return found
