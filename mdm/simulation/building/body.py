"""Bodies: something round that moves on the floor of a building, between walls; and guests of other processes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error
from mdm.maps import Pose
from mdm.messages import Message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.maps import Grid
    from mdm.maps.paths import Paths

    Cell = tuple[int, int]


class Body(ABC):
    """A robot, as others see it: where it is, and where it drives.

    Args:
        name: Its name.
        agent: Its agent in navground.
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
    """Return the ends of all walls, in metres. All beyond the grid is wall."""
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


# -- Bodies of other processes -----------------------------------------------------------------------------------------

_HEARD = 1.0
"""Seconds without a word after which a guest is not there any more."""
_AWAY = 1e6
"""Metres east and north of the map: where a guest is that is not there."""
_ROOM = 0.2
"""Metres between a guest that comes and the next robot: who is nearer than that to others does not get away."""


class Whereabouts(Message, frozen=True, gc=False):
    """Where a robot really is, told on ``<building>/<robot>/whereabouts`` for buildings of which it is a `Guest`.

    Attributes:
        time: When.
        x: In metres.
        y: The same.
        yaw: In radians, anticlockwise from the x axis.
        velocity: In metres a second, along x and y.
        remaining: The metres to go; 0 where it stands.
        way: The points where its way turns, and its end, in metres; none where it stands, or lets others pass.
    """

    x: float
    y: float
    yaw: float
    velocity: tuple[float, float]
    remaining: float
    way: tuple[tuple[float, float], ...]


class Guest(Body):
    """A robot of another process, which a `Building` has as a body that moves: `Building.guest` makes it.

    Robots keep clear of it, and give way to it. Between two words of it, it goes on as it was. It is not on the floor
    where nothing has been heard of it for a second, as when its process has ended; and where it comes back in the midst
    of a robot, as after the network was divided, not before there is room.

    Attributes:
        is_here: Whether it is on the floor.
    """

    def __init__(self, name: str, agent: Any, paths: Paths) -> None:
        super().__init__(name, agent, paths)
        self._told: Whereabouts | None = None
        self._seconds = 0.0
        self.is_here = False
        self._leave()

    @property
    def remaining(self) -> float:
        """The metres to go; 0 where it stands, or is not there."""
        return self._told.remaining if self.is_here and self._told is not None else 0.0

    @property
    def turns(self) -> tuple[tuple[int, int], ...]:
        """The cells where its way turns, and its end; none where it stands, or is not there."""
        points = self._told.way if self.is_here and self._told is not None else ()
        cells = (self._paths.frame.cell(x, y) for x, y in points)
        return tuple(cell for cell in cells if cell is not None)

    def take(self, whereabouts: Whereabouts) -> None:
        """Put the robot at a pose.

        Raises:
            Error: If that is not finite.
        """
        told = whereabouts
        if not all(map(math.isfinite, (told.x, told.y, told.yaw, told.remaining, *told.velocity))):
            raise Error(f"the whereabouts of guest {self.name!r} are not finite: {told}")
        self._told, self._seconds = told, 0.0

    def steer(self, seconds: float, bodies: Sequence[Body] = ()) -> None:
        """Go on as it was told last, before a step of the building."""
        told = self._told
        if told is None:
            return
        if self._seconds > _HEARD:
            self._told = None
            self._leave()
            return
        x, y = (start + speed * self._seconds for start, speed in zip((told.x, told.y), told.velocity, strict=True))
        self._seconds += seconds
        if self.is_here or all(
            math.dist((x, y), body.agent.position) > self.radius + body.radius + _ROOM
            for body in bodies
            if body is not self
        ):
            self.is_here = True
            self._place(x, y, told.yaw, told.velocity)

    def _leave(self) -> None:
        self.is_here = False
        self._place(_AWAY, _AWAY, 0.0, (0.0, 0.0))

    def _place(self, x: float, y: float, yaw: float, velocity: tuple[float, float]) -> None:
        from navground.core import Pose2, Twist2  # noqa: PLC0415 - an extra

        self.agent.pose = Pose2((x, y), yaw)
        self.agent.twist = Twist2(velocity, 0.0)
