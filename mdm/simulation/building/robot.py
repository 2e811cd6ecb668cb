"""A simulated robot: it drives to poses around what stands in its way, and senses with noise."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error
from mdm.maps import Pose
from mdm.maps.sight import sees

if TYPE_CHECKING:
    from mdm.maps import Grid
    from mdm.maps.paths import Paths
    from mdm.models.matrices import Vector

__all__ = ["DriveError", "Robot"]

_NEAR, _TURNED = 0.15, 0.2
"""Metres and radians that a goal may be missed by."""
_PATIENCE = 30.0
"""Seconds without getting nearer after which a drive has failed."""
_LOOKS = 3
"""Steps after which it looks again whether its way is free."""
_NEARER = 0.05
"""Metres that count as nearer."""


class DriveError(Error):
    """A robot cannot come to where it was sent."""


class _Drive:
    """A drive that is under way."""

    def __init__(self, goal: Pose, distances: Vector) -> None:
        self.goal = goal
        self.distances = distances
        self.turns: list[tuple[int, int]] = []
        self.remaining = math.inf
        self.waited = 0.0
        self.looks = 0
        self.over: asyncio.Future[None] = asyncio.get_running_loop().create_future()


class Robot:
    """A robot of a `Building`, which makes it. It is a navigator: ``await robot.go(pose)`` ends at the pose.

    Attributes:
        name: Its name.
        radius: In metres.
        speed: In metres a second.
        noise: The standard deviation of its poses, in metres in each direction.
        ranges: The last distances in metres that its range sensor measured, anticlockwise from behind; empty without
            one.
        collisions: In how many steps it has touched something.
    """

    def __init__(
        self,
        name: str,
        agent: Any,
        grid: Grid,
        paths: Paths,
        *,
        speed: float,
        noise: float,
        generator: np.random.Generator,
        scanner: Any = None,
    ) -> None:
        self.name = name
        self.radius = float(agent.radius)
        self.speed = speed
        self.noise = noise
        self.ranges: Vector = np.zeros(0)
        self.collisions = 0
        self.agent = agent
        self._grid = grid
        self._paths = paths
        self._generator = generator
        self._scanner = scanner
        self._readings: Any = None
        self._drive: _Drive | None = None
        self._fields: dict[tuple[int, int], Vector] = {}

    @property
    def pose(self) -> Pose:
        """Where it really is."""
        (x, y), yaw = self.agent.position, self.agent.orientation
        return Pose(float(x), float(y), float(yaw))

    @property
    def remaining(self) -> float:
        """The metres to go; 0 where it stands."""
        return 0.0 if self._drive is None else self._drive.remaining

    def estimate(self) -> Pose:
        """Return where it believes to be: its pose with noise."""
        true = self.pose
        east, north, turn = self._generator.normal(size=3).tolist()
        return Pose(true.x + self.noise * east, true.y + self.noise * north, true.yaw + 0.2 * self.noise * turn)

    def sees(self, x: float, y: float, reach: float = 5.0) -> bool:
        """Whether a point is near enough, with no wall in between.

        Args:
            x: In metres.
            y: In metres.
            reach: How far it sees, in metres.
        """
        here = self.pose
        if math.hypot(x - here.x, y - here.y) > reach:
            return False
        one, other = self._grid.frame.cell(here.x, here.y), self._grid.frame.cell(x, y)
        return one is not None and other is not None and sees(self._grid.free, one, other)

    async def go(self, pose: Pose) -> None:
        """Drive to a pose, and turn to its yaw. A drive that is cancelled stops where it is.

        Raises:
            DriveError: If the pose cannot be reached, something has been in the way for half a minute, or the robot is
                sent elsewhere meanwhile.
        """
        drive = _Drive(pose, self._distances_to(pose))
        if self._drive is not None:
            self._fail(f"was sent to {pose.x:g}, {pose.y:g} before it had come")
        self._drive = drive
        try:
            await drive.over
        finally:
            if self._drive is drive:
                self._drive = None
                self._halt()

    def _halt(self) -> None:
        from navground.core import Target  # noqa: PLC0415 - an extra

        self.agent.controller.stop()
        self.agent.behavior.target = Target.Stop()  # the controller only forgets where it was to go

    def _distances_to(self, pose: Pose) -> Vector:
        if not pose.is_finite:
            raise DriveError(f"robot {self.name!r} cannot drive to {pose}: it is not finite")
        goal = self._paths.frame.cell(pose.x, pose.y)
        if goal is None or not self._paths.open[goal]:
            raise DriveError(
                f"robot {self.name!r} does not fit at {pose.x:g}, {pose.y:g}: give it a goal at least "
                f"{self.radius:g} m from all walls"
            )
        if goal not in self._fields:
            self._fields[goal] = self._paths.distances([goal])[0]
        here = self._cell()
        if not math.isfinite(self._fields[goal][here]):
            raise DriveError(f"robot {self.name!r} finds no way to {pose.x:g}, {pose.y:g}")
        return self._fields[goal]

    def _cell(self) -> tuple[int, int]:
        """Return the nearest cell that it may be in: pushed against a wall it can be in another."""
        here = self.pose
        cell = self._paths.frame.cell(here.x, here.y)
        if cell is not None and self._paths.open[cell]:
            return cell
        row, column = cell if cell is not None else (0, 0)
        cells = np.argwhere(self._paths.open)
        nearest = cells[np.hypot(cells[:, 0] - row, cells[:, 1] - column).argmin()]
        return int(nearest[0]), int(nearest[1])

    def _distance(self, cell: tuple[int, int]) -> float:
        x, y = self.agent.position
        return math.dist((x, y), self._grid.frame.centre(*cell))

    def steer(self, seconds: float) -> None:
        """Set out for the next point of the path, before a step of the building."""
        drive = self._drive
        if drive is None or drive.over.done():
            return
        cell = self._cell()
        here = float(drive.distances[cell])
        if here < drive.remaining - _NEARER:
            drive.remaining, drive.waited = here, 0.0
        else:
            drive.waited += seconds
            if drive.waited > _PATIENCE:
                self._fail(f"has come no nearer to {drive.goal.x:g}, {drive.goal.y:g} for {_PATIENCE:g} s")
                return
        self._turn(drive, cell)
        controller = self.agent.controller
        if len(drive.turns) == 1:
            from navground.core import Pose2  # noqa: PLC0415 - an extra

            controller.go_to_pose(Pose2((drive.goal.x, drive.goal.y), drive.goal.yaw), _NEAR, _TURNED)
        else:
            controller.go_to_position(np.array(self._paths.frame.centre(*drive.turns[0])), _NEAR / 2)

    def _turn(self, drive: _Drive, cell: tuple[int, int]) -> None:
        """Take up the next turn of the way where it is in sight, or the last one is reached."""
        drive.looks += 1
        in_time = drive.looks % _LOOKS == 1
        turns, cells = drive.turns, self._paths.open
        while len(turns) > 1 and (self._distance(turns[0]) < _NEAR or (in_time and sees(cells, cell, turns[1]))):
            del turns[0]
        if in_time and drive.waited < 1.0 and not (turns and sees(cells, cell, turns[0])):
            drive.turns = self._paths.route(drive.distances, cell)  # it sets out, or was pushed off its way

    def look(self, world: Any) -> None:
        """Take in what a step has brought about."""
        if any(self.agent in pair for pair in world.collisions):
            self.collisions += 1
        if self._scanner is not None:
            if self._readings is None:
                from navground.core import SensingState  # noqa: PLC0415 - an extra

                self._readings = SensingState()
            self._scanner.update(self.agent, world, self._readings)
            self.ranges = np.array(self._readings.get_buffer("range").data, dtype=np.float64)
        drive = self._drive
        if drive is None or drive.over.done():
            return
        here, goal = self.pose, drive.goal
        turned = abs(math.remainder(here.yaw - goal.yaw, math.tau))
        if math.hypot(here.x - goal.x, here.y - goal.y) <= 1.5 * _NEAR and turned <= 1.5 * _TURNED:
            drive.over.set_result(None)

    def _fail(self, text: str) -> None:
        if self._drive is not None and not self._drive.over.done():
            self._drive.over.set_exception(DriveError(f"robot {self.name!r} {text}"))
