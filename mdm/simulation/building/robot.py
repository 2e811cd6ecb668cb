"""A simulated robot: it drives to poses around obstacles, and senses with noise."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import Error, MapError
from mdm.maps import Pose
from mdm.maps.paths import PATH_MARGIN, Paths, sees
from mdm.simulation.building.body import Body, Whereabouts
from mdm.simulation.building.refuge import GAP, Brakes, refuge, way_out

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.maps import Grid
    from mdm.models.matrices import Vector

    Cell = tuple[int, int]

_NEAR, _TURNED = 0.15, 0.2
"""Metres and radians that a goal may be missed by."""
_PATIENCE = 30.0
"""Seconds without getting nearer after which a drive has failed."""
_LOOKS = 3
"""Steps after which it looks again whether its way is free."""
_NEARER = 0.05
"""Metres that count as nearer."""
_STUCK, _SLOW = 1.0, 0.02
"""Seconds below so many metres a second after which a robot that drives keeps no margin but that of its brakes."""
_COMFORT = 0.15
"""Metres that it keeps from all where there is room."""
_TRUE = 0.6
"""Cells by which the room may be less than the clearance of a cell says."""
_AHEAD, _SAMPLES = 1.5, 16
"""Metres for which it looks ahead along its way, and at how many points."""
_CLEAR, _FREEING = 0.15, 2.0
"""Metres from walls to which a robot drives for so many seconds that its brakes have stopped beside one."""
_POINT = 4.0
"""Seconds in which it comes to the next point of a way out, or looks for another."""
_BESIDE_OTHERS = 2.5
"""Seconds for which it stands first where others drive near it, who may have to give way."""
_HELD, _MOVED = 50.0, 0.5
"""Seconds in which a robot that drives, or lets others pass, has moved so many metres, or its drive has failed."""
_CARE, _CAREFUL, _STILL = 2.0, 4.0, 0.25
"""Seconds within so many metres after which it follows its way from cell to cell, and for how many."""
_TURNING, _AIMED, _THERE = 1.5, 0.1, 0.015
"""How fast it turns then, in radians a second, at how many it drives on, and how many metres near a cell is reached."""
_BLOCKED = 2.0
"""Seconds without getting nearer after which a robot gives way to one that was put there before it."""
_IN_TURN = 3
"""How many times longer it takes until the other one of two gives way."""
_MEETING = 3.0
"""Metres from one another within which robots may be in each other's way."""
_BESIDE = 0.3
"""Metres from its way around a body within which a robot goes back to it."""
_PASSED, _LONGEST = 2.0, 15.0
"""Metres that the others have driven on, and seconds, after which a robot that gave way goes on."""


class DriveError(Error):
    """A robot cannot come to where it was sent."""


class Robot(Body):
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
        clearance: Vector,
        scanner: Any = None,
    ) -> None:
        super().__init__(name, agent, paths)
        self.speed = speed
        self.noise = noise
        self.ranges: Vector = np.zeros(0)
        self.collisions = 0
        self._grid = grid
        self._clearance = clearance
        self._generator = generator
        self._scanner = scanner
        self._readings: Any = None
        self._drive: _Drive | None = None
        self._aside: _Aside | None = None
        self._fields: dict[tuple[int, int], Vector] = {}

    @property
    def remaining(self) -> float:
        """The metres to go; 0 where it stands."""
        return 0.0 if self._drive is None else self._drive.remaining

    @property
    def goal(self) -> Pose | None:
        """Where it drives to; None where it stands."""
        return None if self._drive is None else self._drive.goal

    @property
    def turns(self) -> tuple[tuple[int, int], ...]:
        """The cells where its way turns, and its end; none where it stands, or lets others pass."""
        return () if self._drive is None or self._aside is not None else tuple(self._drive.turns)

    def whereabouts(self, time: int) -> Whereabouts:
        """Return where it really is and drives, for buildings of which it is a guest, with the time in nanoseconds."""
        here, (east, north) = self.pose, self.agent.velocity.tolist()
        way = tuple(self._paths.frame.centre(*cell) for cell in self.turns)
        return Whereabouts(time, here.x, here.y, here.yaw, (east, north), self.remaining, way)

    def estimate(self, at: Pose | None = None) -> Pose:
        """Return where it believes to be: its pose with noise, or another one where it is said to be."""
        true = self.pose if at is None else at
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
            DriveError: If the pose cannot be reached, something has been in the way for half a minute (that in which
                the robot gives way to others is not counted), or the robot is sent elsewhere or its building stops
                meanwhile.
        """
        distances = self._distances_to(pose)
        if self._drive is not None:
            self.fail(f"was sent to {pose.x:g}, {pose.y:g} before it had arrived")
        self._drive = drive = _Drive(pose, self._paths, distances, float(distances[self.cell]))
        self._aside = None
        try:
            await drive.over
        finally:
            if self._drive is drive:
                from navground.core import Target  # noqa: PLC0415 - an extra

                self._drive = self._aside = None
                self.agent.controller.stop()
                self.agent.behavior.target = Target.Stop()  # the controller only forgets where it was to go

    def _distances_to(self, pose: Pose) -> Vector:
        if not pose.is_finite:
            raise DriveError(f"robot {self.name!r} cannot drive to {pose}: it is not finite")
        goal = self._paths.frame.cell(pose.x, pose.y)
        if goal is not None and not self._paths.open[goal]:
            goal = self._beside(goal)
        if goal is None:
            raise DriveError(
                f"robot {self.name!r} does not fit at {pose.x:g}, {pose.y:g}: give it a goal at least "
                f"{self.radius:g} m from all walls"
            )
        if goal not in self._fields:
            self._fields[goal] = self._paths.distances([goal])[0]
        here = self.cell
        if not math.isfinite(self._fields[goal][here]):
            raise DriveError(f"robot {self.name!r} finds no way to {pose.x:g}, {pose.y:g}")
        return self._fields[goal]

    def _beside(self, goal: Cell) -> Cell | None:
        """Return the nearest cell to a goal's that it may be in, near enough to count as there."""
        away = np.argwhere(self._paths.open)
        metres = np.hypot(*(away - goal).T) * self._paths.frame.resolution
        nearest = int(metres.argmin()) if len(away) else 0
        if not len(away) or metres[nearest] > _NEAR:
            return None
        return int(away[nearest][0]), int(away[nearest][1])

    def _away(self, body: Body) -> float:
        """Return the metres between its middle and another's."""
        return math.dist(self.agent.position, body.agent.position)

    def _distance(self, cell: tuple[int, int]) -> float:
        x, y = self.agent.position
        return math.dist((x, y), self._grid.frame.centre(*cell))

    def steer(self, seconds: float, bodies: Sequence[Body] = ()) -> None:
        """Set out for the next point of the path, before a step of the building.

        Args:
            seconds: Since the last step.
            bodies: All that are in the building; of two in each other's way the later one gives way first.
        """
        drive = self._drive
        if drive is None or drive.over.done() or self._is_held(drive, seconds, bodies):
            return
        stays = self._aside is None or not self._aside.is_over()
        if stays and self._frees_itself(drive, seconds, bodies):
            if self._aside is not None:
                self._aside.seconds += seconds
            return
        cell = self.cell
        if self._aside is not None:
            self._stay_aside(self._aside, drive, cell, seconds)
            return
        here = float(drive.distances[cell])
        if here < drive.remaining - _NEARER:
            drive.remaining, drive.waited, drive.blocked, drive.again = here, 0.0, 0.0, 0.0
        else:
            drive.waited += seconds
            drive.blocked += seconds
            if drive.waited > _PATIENCE:
                where = f"{drive.goal.x:g}, {drive.goal.y:g}"
                self.fail(f"has come no nearer to {where} for {_PATIENCE:g} s{self._beside_whom(bodies)}")
                return
            if drive.blocked > _BLOCKED:
                if self._give_way(drive, bodies):
                    return
                self._go_round(drive, bodies)
        self._turn(drive, cell)
        self._take_care(drive, seconds, bodies)
        self.agent.behavior.safety_margin = self._margin(drive.turns[0])
        controller = self.agent.controller
        if len(drive.turns) == 1:
            from navground.core import Pose2  # noqa: PLC0415 - an extra

            controller.go_to_pose(Pose2((drive.goal.x, drive.goal.y), drive.goal.yaw), _NEAR, _TURNED)
        else:
            controller.go_to_position(np.array(self._paths.frame.centre(*drive.turns[0])), _NEAR / 2)

    def brake(self, seconds: float, brakes: Brakes, bodies: Sequence[Body]) -> None:
        """Drive less than it is about to where that would touch something, in a step of the building."""
        from navground.core import Frame, Twist2  # noqa: PLC0415 - an extra

        told = self.agent.last_cmd.relative(self.agent.pose)
        forward, turning = float(told.velocity[0]), float(told.angular_speed)
        drive = self._drive
        chosen = None
        if drive is not None and drive.way_out:
            chosen = self._towards(drive.way_out[0], seconds)
        elif drive is not None and drive.careful > 0 and drive.freeing <= 0:
            chosen = self._along(drive, seconds)
        if drive is not None and chosen is not None:
            forward, turning = chosen
            if forward == 0:
                drive.stuck = 0.0  # it turns to where it will drive
        share = brakes.share(self, forward * seconds, turning * seconds, bodies)
        if share < 1.0 or chosen is not None:
            self.agent.last_cmd = Twist2((share * forward, 0.0), turning, Frame.relative)

    def _take_care(self, drive: _Drive, seconds: float, bodies: Sequence[Body]) -> None:
        """Follow the way itself, for a time, where nobody drives near it and keeping off walls got it no nearer.

        Before the mouth of a narrow passage that turns round and round.
        """
        if drive.careful <= 0:
            drive.step = None
        drive.careful -= seconds
        there = float(drive.distances[self.cell])
        drive.still += seconds
        if abs(there - drive.there) > min(_STILL, self.speed / 2):
            drive.there, drive.still = there, 0.0
        if any(body is not self and body.remaining and self._away(body) < _MEETING for body in bodies):
            drive.careful = 0.0
        elif drive.still > _CARE:
            drive.careful = _CAREFUL
        if len(drive.turns) == 1 and self._distance(drive.turns[0]) < _NEAR:
            drive.careful = 0.0

    def _along(self, drive: _Drive, seconds: float) -> tuple[float, float] | None:
        """Return the speeds, ahead and of turning, from the middle of a cell of its way to that of the next one.

        None where it was pushed to a cell from which there is no way.
        """
        if drive.step is None or self._distance(drive.step) < _THERE:
            try:
                drive.step = drive.paths.next(drive.distances, self.cell)
            except MapError:
                drive.careful = 0.0
                return None
        return self._towards(self._grid.frame.centre(*drive.step), seconds)

    def _towards(self, point: tuple[float, float], seconds: float) -> tuple[float, float]:
        """Return the speeds, ahead and of turning, at which it drives straight to a point."""
        here, (x, y) = self.pose, point
        off = math.remainder(math.atan2(y - here.y, x - here.x) - here.yaw, math.tau)
        turning = max(-_TURNING, min(_TURNING, off / seconds))
        metres = math.dist((x, y), (here.x, here.y))
        return (min(self.speed / 2, metres / seconds) if abs(off) < _AIMED else 0.0), turning

    def _give_way(self, drive: _Drive, bodies: Sequence[Body]) -> bool:
        """Set out for where others can pass, if it is to let them; return whether it does."""
        here = self.agent.position
        near = [body for body in bodies if body is not self and math.dist(here, body.agent.position) < _MEETING]
        others = [body for body in near if body.turns]
        is_later = any(body in others for body in bodies[: bodies.index(self)])
        if not others or drive.blocked < (_BLOCKED if is_later else _IN_TURN * _BLOCKED):
            return False
        drive.blocked = 0.0
        turns = refuge(self._paths, self.cell, [(one.cell, one.turns, self.radius + one.radius) for one in near])
        if turns is not None:
            self._aside = _Aside(turns, others)
        return turns is not None

    def _go_round(self, drive: _Drive, bodies: Sequence[Body]) -> None:
        """Find another way, around the bodies that stand in this one, where there is one."""
        standing = {
            body.cell: self.radius + body.radius + 2 * PATH_MARGIN
            for body in bodies
            if body is not self and not body.remaining
        }
        around = frozenset(standing)
        if around <= drive.around or drive.waited < drive.again:
            return
        drive.again = drive.waited + _BLOCKED
        rows, columns = np.indices(self._paths.frame.shape)
        free = self._paths.open.copy()
        for cell, extent in standing.items():
            free &= np.hypot(rows - cell[0], columns - cell[1]) * self._paths.frame.resolution > extent
        free[self.cell] = True
        goal = np.unravel_index(drive.distances.argmin(), drive.distances.shape)
        if not free[goal]:
            drive.around |= around
            return
        paths = Paths(self._paths.frame, free)
        distances, _ = paths.distances([(int(goal[0]), int(goal[1]))])
        if math.isfinite(distances[self.cell]):
            drive.paths, drive.distances, drive.around = paths, distances, drive.around | around
            drive.remaining, drive.blocked = float(distances[self.cell]), 0.0
            drive.turns, drive.step = paths.route(distances, self.cell), None

    def _set_out(self, drive: _Drive, cell: Cell) -> None:
        """Take the shortest way from a cell; around bodies no more where it was pushed to where one stood."""
        begin = cell
        if not math.isfinite(drive.distances[cell]):
            known = np.argwhere(np.isfinite(drive.distances))
            metres = np.hypot(*(known - cell).T) * self._paths.frame.resolution
            row, column = known[int(metres.argmin())].tolist()
            begin = row, column
            if metres.min() > _BESIDE:
                goal = np.unravel_index(drive.distances.argmin(), drive.distances.shape)
                drive.paths, drive.distances = self._paths, self._fields[int(goal[0]), int(goal[1])]
                drive.around, begin = frozenset(), cell
        drive.turns, drive.step = drive.paths.route(drive.distances, begin), None
        if begin != cell:
            drive.turns.insert(0, begin)

    def _margin(self, turn: Cell) -> float:
        """Return the metres to keep from all, as the way ahead has room: in a narrow passage less."""
        x, y = self.agent.position.tolist()
        end = self._grid.frame.centre(*turn)
        share = min(1.0, _AHEAD / max(math.dist((x, y), end), _NEARER))
        cells = (
            self._grid.frame.cell(x + part * (end[0] - x), y + part * (end[1] - y))
            for part in np.linspace(0.0, share, _SAMPLES).tolist()
        )
        room = min(float(self._clearance[cell]) if cell is not None else 0.0 for cell in cells)
        return max(GAP, min(_COMFORT, room - self.radius - _TRUE * self._grid.frame.resolution))

    def _frees_itself(self, drive: _Drive, seconds: float, bodies: Sequence[Body]) -> bool:
        """Drive a little away from the obstacle where the brakes have stopped it; return whether it does."""
        if drive.freeing <= 0 and drive.stuck > _STUCK:
            away_from = {body: self._away(body) for body in bodies if body is not self}
            if not any(body.remaining and metres < _MEETING for body, metres in away_from.items()):
                self._find_a_way_out(drive, seconds, list(away_from))
            elif drive.stuck < _BESIDE_OTHERS or not self._frees_itself_beside_others(drive, away_from):
                return False
        if drive.freeing <= 0:
            return False
        drive.freeing -= seconds
        if self._aside is None:
            drive.waited += seconds
            drive.blocked += seconds
        while drive.way_out and math.dist(drive.way_out[0], self.agent.position) < _THERE:
            del drive.way_out[0]
            drive.freeing = _POINT if drive.way_out else 0.0
        if drive.freeing <= 0:
            drive.way_out = []
        elif drive.free is not None:
            self.agent.behavior.safety_margin = 0.0
            self.agent.controller.go_to_position(np.array(drive.free), _NEAR / 3)
        return True

    def _find_a_way_out(self, drive: _Drive, seconds: float, others: Sequence[Body]) -> None:
        """Look for a way to where it has room, once a second while there is none."""
        if (drive.stuck - _STUCK) % _STUCK > seconds:
            return
        here = self.agent.position.tolist()
        ample = [(self._clearance > self.radius + _CLEAR, _CLEAR), (self._paths.open, 2 * PATH_MARGIN)]
        found = way_out((here[0], here[1]), self.radius, self._grid, others, ample)
        if found and math.dist(found[-1], here) > self._grid.frame.resolution:
            drive.way_out, drive.free, drive.freeing, drive.stuck, drive.step = found, None, _POINT, 0.0, None

    def _frees_itself_beside_others(self, drive: _Drive, away_from: Mapping[Body, float]) -> bool:
        """Set out for the nearest cell that is far enough from walls; return whether there is one."""
        near = [body for body, metres in away_from.items() if metres < self.radius + body.radius + 2 * _CLEAR]
        if self._aside is None and near:
            return False  # who drives is to pass, or to be let pass
        here, side = self.pose, self._grid.frame.resolution
        row, column = self._grid.frame.locate(here.x, here.y)
        cells = np.argwhere(self._clearance > self.radius + _CLEAR)
        for body in near:
            there = self._grid.frame.locate(body.pose.x, body.pose.y)
            metres = np.hypot(cells[:, 0] - there[0], cells[:, 1] - there[1]) * side
            cells = cells[metres > self.radius + body.radius + _CLEAR]
        away = np.hypot(cells[:, 0] - row, cells[:, 1] - column) * side
        if not len(away) or not side < away.min() < 1.0:
            return False
        drive.free = self._grid.frame.centre(*cells[away.argmin()].tolist())
        drive.freeing, drive.stuck, drive.step = _FREEING, 0.0, None
        return True

    def _is_held(self, drive: _Drive, seconds: float, bodies: Sequence[Body]) -> bool:
        """Let a drive fail that has got nowhere for long, whatever it waited for."""
        x, y = self.agent.position.tolist()
        if math.dist(drive.at, (x, y)) > _MOVED:
            drive.at, drive.held = (x, y), 0.0
        drive.held += seconds
        drive.stuck = 0.0 if float(np.hypot(*self.agent.velocity)) > _SLOW else drive.stuck + seconds
        if drive.held > _HELD:
            self.fail(f"has been held up for {_HELD:g} s{self._beside_whom(bodies)}")
        return drive.held > _HELD

    def _beside_whom(self, bodies: Sequence[Body]) -> str:
        """Return in words who is nearest, if anybody is near."""
        away = {body.name: math.dist(self.agent.position, body.agent.position) for body in bodies if body is not self}
        near = min(away, key=away.__getitem__, default=None)
        return f", beside {near!r}" if near is not None and away[near] < _MEETING else ""

    def _stay_aside(self, aside: _Aside, drive: _Drive, cell: tuple[int, int], seconds: float) -> None:
        aside.seconds += seconds
        if aside.is_over():
            self._aside = None
            self._set_out(drive, cell)
            return
        while len(aside.turns) > 1 and self._distance(aside.turns[0]) < _NEAR:
            del aside.turns[0]
        self.agent.behavior.safety_margin = self._margin(aside.turns[0])
        self.agent.controller.go_to_position(np.array(self._paths.frame.centre(*aside.turns[0])), _NEAR / 2)

    def _turn(self, drive: _Drive, cell: tuple[int, int]) -> None:
        """Take up the next turn of the way where it is in sight, or the last one is reached."""
        drive.looks += 1
        in_time = drive.looks % _LOOKS == 1
        turns, cells = drive.turns, drive.paths.open
        while len(turns) > 1 and (self._distance(turns[0]) < _NEAR or (in_time and sees(cells, cell, turns[1]))):
            del turns[0]
        if in_time and drive.waited < 1.0 and not (turns and sees(cells, cell, turns[0])):
            self._set_out(drive, cell)  # for the first time, or it was pushed off its way

    def look(self, world: Any) -> None:
        """Take in the results of a step."""
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

    def fail(self, text: str) -> None:
        """Let the drive that is under way fail, if there is one."""
        if self._drive is not None and not self._drive.over.done():
            self._drive.over.set_exception(DriveError(f"robot {self.name!r} {text}"))


class _Drive:
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


class _Aside:
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
        return passed or self.seconds > _LONGEST
