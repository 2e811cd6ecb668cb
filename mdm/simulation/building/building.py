"""The building: an actor that moves its robots step by step, and lets visits come and go."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.checks import is_number, is_whole
from mdm.errors import ConfigError, Error, MapError
from mdm.maps.paths import PATH_MARGIN, Paths, drivable
from mdm.messages import PoseUpdate
from mdm.runtime import Actor
from mdm.simulation.building.body import Guest, Whereabouts, walls
from mdm.simulation.building.refuge import GAP, Brakes
from mdm.simulation.building.robot import Robot
from mdm.simulation.building.visits import Bystander, Visit, VisitChange, Visits

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from mdm.maps import Grid, Map, Pose
    from mdm.maps.places import Places
    from mdm.messages import Tick
    from mdm.runtime import Channel
    from mdm.simulation.building.body import Body

_RATE = 10.0
"""Steps a second; robots tell their poses as often."""
_SPACE = 0.4
"""Metres between a visit and the next wall, at least."""
_BESIDE, _APART = 0.5, 0.2
"""Metres that are free between a visit's body and goals, and other bodies."""
_TRIES = 20
"""Points that are tried for a visit's body until one is in nobody's way."""
_AWAY = -1e6
"""Metres east of the map, and of each other: where robots are that are on another floor."""
_ROOM = 0.2
"""Metres between a robot that comes from another floor and the next one."""
_MOST = 10
"""Steps at once, where the clock has run ahead."""


class Building(Actor):
    """A floor with robots that drive, and people, intruders and fires that come and go.

    It steps ten times a second of the runtime's clock, in wall or virtual time. Robots keep clear of walls and of each
    other; where two meet and neither gets on, one drives out of the way until the other has passed. The same seed gives
    the same run in virtual time.

    Args:
        floor: The map, with its grid.
        visits: The visits: how often they come, and for how long.
        seed: The seed of all that is random.
        name: Its name among actors.

    Raises:
        ConfigError: If two visits are of one kind, or have no place.
        MapError: If the map has no grid, or visits are to places that are not on it, or have no room for them.
        Error: If navground is not installed.

    Attributes:
        floor: The map.
        robots: The robots by name.
        guests: Those of other processes, by name.
        steps: The number of steps so far.

    Example::

        async def main():
            building = Building(floor, visits=[Visits("person", every=60.0, stay=120.0)], seed=1)
            robot = building.robot("ada", at="Hall")
            async with mdm.Runtime(log=None) as runtime:
                await runtime.start(building)
                await robot.go(floor.graph.node("Kitchen").goal)


        mdm.run(main, virtual=True)
    """

    def __init__(
        self, floor: Map, *, visits: Iterable[Visits] = (), seed: int | None = None, name: str = "building"
    ) -> None:
        super().__init__(name)
        grid: Grid | None = getattr(floor, "grid", None)
        if grid is None:
            raise MapError(
                "a building needs a map with a grid, which says where walls are; for several floors make a Tower"
            )
        core, simulator = _navground()
        self.floor = floor
        self.grid = grid
        self._clearance = grid.clearance()
        self.robots: dict[str, Robot] = {}
        self.guests: dict[str, Guest] = {}
        self._bystanders: list[Bystander] = []
        self._away: set[str] = set()  # the robots that are on another floor
        self._bodies: dict[str, Body] = {}  # robots and guests, in the order in which they were put there
        self.steps = 0
        self._world = simulator.World()
        self._generators = np.random.SeedSequence(seed)
        self._world.seed = int(self._generators.generate_state(1)[0])
        for one, other in walls(self.grid):
            self._world.add_wall(simulator.Wall(core.LineSegment(one, other)))
        self._brakes = Brakes(self.grid)
        self._visits = {each.kind: each for each in self._checked(visits)}
        self._present: list[Visit] = []
        self._came = 0
        self._random = np.random.default_rng(self._generators.spawn(1)[0])
        self._paths: dict[float, Paths] = {}
        self._channels: dict[str, tuple[Channel[PoseUpdate], Channel[Whereabouts]]] = {}
        self._places: dict[str, Places] = {}

    def _checked(self, visits: Iterable[Visits]) -> list[Visits]:
        known: list[Visits] = []
        for each in visits:
            if any(each.kind == other.kind for other in known):
                raise ConfigError(f"the kind {each.kind!r} of visits is given twice", key="visits")
            for place in self._places_of(each):
                self.floor.graph.node(place)
                if not len(self._room_in(place)):
                    raise MapError(f"no {each.kind} has room in {place!r}: name other places for these visits")
            known.append(each)
        return known

    def _places_of(self, visits: Visits) -> tuple[str, ...]:
        return self.floor.graph.names if visits.places is None else tuple(visits.places)

    def _room_in(self, place: str) -> NDArray[np.intp]:
        return np.argwhere(self.floor.labels.cells(place) & (self._clearance > _SPACE))

    # -- Robots --------------------------------------------------------------------------------------------------

    def robot(
        self,
        name: str,
        *,
        at: str | Pose | None,
        places: Places | None = None,
        radius: float = 0.25,
        speed: float = 0.5,
        noise: float = 0.1,
        beams: int = 0,
        reach: float = 5.0,
    ) -> Robot:
        """Put a robot on the floor, before or after it starts. Its poses are told on ``<building>/<name>/pose``.

        Args:
            name: Its name.
            at: Where it begins: a place, at its goal, or a pose; None where it is not on the floor yet, see `enter`.
            places: Told of its poses, too.
            radius: In metres.
            speed: In metres a second.
            noise: The standard deviation of its poses, in metres in each direction.
            beams: Of its range sensor; 0 for none.
            reach: Of its range sensor, in metres.

        Raises:
            ConfigError: If there is a robot of that name, or a number is none that a robot can have.
            MapError: If it does not fit there, or there is no such place.
        """
        self._check_name(name)
        _check(name, radius=radius, speed=speed, reach=reach, noise=noise, beams=beams)
        start = self.floor.graph.node(at).goal if isinstance(at, str) else at
        if start is not None:
            cell = self.grid.frame.cell(start.x, start.y)
            if cell is None or self._clearance[cell] < radius:
                raise MapError(f"robot {name!r} does not fit at {start.x:g}, {start.y:g}: it would stand in a wall")
            for other in self._bodies.values():
                if math.dist((start.x, start.y), (other.pose.x, other.pose.y)) < radius + other.radius:
                    raise MapError(
                        f"robot {name!r} does not fit at {start.x:g}, {start.y:g}: robot {other.name!r} is there"
                    )
        paths = self._paths_for(radius)
        core, simulator = _navground()
        kinematics = core.kinematics.TwoWheelsDifferentialDriveKinematics(max_speed=speed, wheel_axis=1.6 * radius)
        behavior = core.behaviors.HLBehavior(kinematics=kinematics, radius=radius)
        behavior.optimal_speed = speed
        behavior.horizon = 2.0
        behavior.safety_margin = GAP
        agent = simulator.Agent(
            radius=radius,
            behavior=behavior,
            kinematics=kinematics,
            state_estimations=[simulator.state_estimations.BoundedStateEstimation(range=5.0)],
            control_period=1 / _RATE,
        )
        if start is not None:
            agent.pose = core.Pose2((start.x, start.y), start.yaw)
        scanner = None
        if beams:
            scanner = simulator.state_estimations.LidarStateEstimation(range=reach, resolution=beams)
        self._world.add_agent(agent)
        generator = np.random.default_rng(self._generators.spawn(1)[0])
        robot = Robot(
            *(name, agent, self.grid, paths),
            speed=speed,
            noise=noise,
            generator=generator,
            clearance=self._clearance,
            scanner=scanner,
        )
        self.robots[name] = self._bodies[name] = robot
        if start is None:
            self.leave(name)
        if places is not None:
            self._places[name] = places
        return robot

    def leave(self, name: str) -> None:
        """Take a robot off the floor, as one that goes to another one."""
        from navground.core import Pose2, Twist2  # noqa: PLC0415 - an extra

        robot = self.robots[name]
        robot.fail("has left the floor")
        self._away.add(name)
        robot.agent.pose = Pose2((_AWAY * (1 + [*self.robots].index(name)), _AWAY), 0.0)
        robot.agent.twist = Twist2((0.0, 0.0), 0.0)

    def enter(self, name: str, pose: Pose) -> bool:
        """Put a robot that has left back on the floor; return whether there was room."""
        from navground.core import Pose2  # noqa: PLC0415 - an extra

        robot = self.robots[name]
        near = (body for body in self._standing() if body is not robot)
        for other in near:
            if math.dist((pose.x, pose.y), other.agent.position) < robot.radius + other.radius + _ROOM:
                return False
        self._away.discard(name)
        robot.agent.pose = Pose2((pose.x, pose.y), pose.yaw)
        return True

    def _standing(self) -> tuple[Body, ...]:
        """Return all bodies that are on the floor."""
        visits = (one for one in self._bystanders if one.visit is not None)
        return (*(body for name, body in self._bodies.items() if name not in self._away), *visits)

    def guest(self, name: str, *, radius: float = 0.25) -> Guest:
        """Have a robot of another process on the floor, where that tells it to be; robots of this one give way to it.

        Of two in each other's way the one that was put there later gives way first, and that is to be the same robot
        in both processes: put all of them there in one order.

        Args:
            name: Its name.
            radius: In metres.

        Raises:
            ConfigError: If there is a robot of that name, or the radius is none that a robot can have.

        Example::

            guest = building.guest("bob")
            member = team.member(
                "ada",
                patrol,
                exports={"building/ada/whereabouts": Whereabouts},
                imports={"bob/building/bob/whereabouts": Whereabouts},
            )
            member.imported("bob/building/bob/whereabouts").subscribe(guest.take)
        """
        self._check_name(name)
        _check(name, radius=radius)
        _, simulator = _navground()
        agent = simulator.Agent(radius=radius)
        guest = Guest(name, agent, self._paths_for(radius))
        self._world.add_agent(agent)
        self.guests[name] = self._bodies[name] = guest
        return guest

    def _check_name(self, name: str) -> None:
        if name in self._bodies:
            raise ConfigError(f"two robots are called {name!r}", key=name)

    def _paths_for(self, radius: float) -> Paths:
        if radius not in self._paths:
            self._paths[radius] = Paths(self.grid.frame, drivable(self.grid, radius))
        return self._paths[radius]

    # -- Visits --------------------------------------------------------------------------------------------------

    def present(self, kind: str, place: str | None = None) -> tuple[Visit, ...]:
        """Return the visits of a kind that are there now, in one place or in all.

        Raises:
            ConfigError: If there are no such visits.
        """
        self._kind(kind)
        return tuple(each for each in self._present if each.kind == kind and place in {None, each.place})

    def come(self, kind: str, place: str) -> Visit:
        """Let something come to a place now.

        Raises:
            ConfigError: If there are no such visits.
            MapError: If there is no such place.
        """
        cells = self._room_in(place)
        if not len(cells):
            raise MapError(f"nothing has room in {place!r}")
        visits = self._kind(kind)
        x, y, fits = self._point(cells, visits.radius)
        self._came += 1
        visit = Visit(self._came, kind, place, x, y)
        if fits:
            self._bystander(visits.radius).come(visit)
        stay = visits.stay
        self._present.append(visit)
        self._tell(visit, came=True)
        if math.isfinite(stay):
            self.call_later(self._random.exponential(stay), lambda: self.go(visit))
        return visit

    def go(self, visit: Visit) -> None:
        """Let something go, or take it as seen to; nothing happens where it has gone already."""
        if visit in self._present:
            self._present.remove(visit)
            for bystander in self._bystanders:
                if bystander.visit is visit:
                    bystander.leave()
            self._tell(visit, came=False)

    def _point(self, cells: NDArray[np.intp], radius: float) -> tuple[float, float, bool]:
        """Return where a visit is, and whether it has a body: that shuts no way, and stands on no goal and nobody."""
        rows, columns = np.indices(self.grid.frame.shape)
        side = self.grid.frame.resolution
        sizes = {body.radius for body in self._bodies.values()}
        widest = max(sizes, default=0.0)
        paths = [self._paths_for(size) for size in sorted(sizes)]
        ends = [self.grid.frame.cell(node.goal.x, node.goal.y) for node in self.floor.graph.nodes]
        standing = [bystander for bystander in self._bystanders if bystander.visit is not None]
        for _ in range(_TRIES):
            row, column = cells[self._random.integers(len(cells))].tolist()
            x, y = self.grid.frame.centre(row, column)
            if not radius:
                return x, y, False
            goals = (math.dist((x, y), (node.goal.x, node.goal.y)) for node in self.floor.graph.nodes)
            bodies = (
                math.dist((x, y), body.agent.position) - body.radius for body in (*self._bodies.values(), *standing)
            )
            if min(goals) < radius + _BESIDE or min(bodies, default=math.inf) < radius + _APART:
                continue
            for way in paths:
                free = way.open.copy()
                for there, extent in [((row, column), radius), *((one.cell, one.radius) for one in standing)]:
                    needed = extent + widest + 2 * PATH_MARGIN  # as of who goes round it
                    free &= np.hypot(rows - there[0], columns - there[1]) * side > needed
                if _groups(free, ends) > _groups(way.open, ends):
                    break
            else:
                return x, y, True
        return x, y, False

    def _bystander(self, radius: float) -> Bystander:
        """Return a body that is nobody's."""
        for bystander in self._bystanders:
            if bystander.visit is None and math.isclose(bystander.radius, radius, rel_tol=1e-5):  # 32 bits there
                return bystander
        _, simulator = _navground()
        agent = simulator.Agent(radius=radius)
        self._bystanders.append(Bystander(len(self._bystanders), agent, self._paths_for(radius)))
        self._world.add_agent(agent)
        return self._bystanders[-1]

    def _kind(self, kind: str) -> Visits:
        if kind not in self._visits:
            raise ConfigError(
                f"there are no visits of the kind {kind!r}; there are {', '.join(self._visits)}", key=kind
            )
        return self._visits[kind]

    def _tell(self, visit: Visit, *, came: bool) -> None:
        now = self.runtime.clock.now()
        self._changes.publish(VisitChange(now, visit.number, visit.kind, visit.place, visit.x, visit.y, came))

    def _await(self, visits: Visits) -> None:
        def come() -> None:
            names = self._places_of(visits)
            self.come(visits.kind, names[self._random.integers(len(names))])
            self._await(visits)

        if math.isfinite(visits.every):
            self.call_later(self._random.exponential(visits.every), come)

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Begin to step."""
        self._changes = self.channel("visits", VisitChange)
        self._channels = {}
        for visits in self._visits.values():
            self._await(visits)
        self.every(_RATE, self._step)

    def on_stop(self) -> None:
        """End all drives: nothing moves any more."""
        for robot in self.robots.values():
            robot.fail("cannot go on: the building has stopped")

    def _step(self, tick: Tick) -> None:
        robots = tuple(robot for name, robot in self.robots.items() if name not in self._away)
        bodies = self._standing()
        for _ in range(min(_MOST, 1 + tick.missed)):
            for body in bodies:
                body.steer(1 / _RATE, bodies)
            self._world.update_dry(1 / _RATE, advance_time=False)
            for robot in robots:
                robot.brake(1 / _RATE, self._brakes, bodies)
            self._world.actuate(1 / _RATE)
            self.steps += 1
            for robot in robots:
                robot.look(self._world)
        for robot in robots:
            name, pose = robot.name, robot.estimate()
            if name not in self._channels:
                whereabouts = self.channel(f"{name}/whereabouts", Whereabouts)
                self._channels[name] = self.channel(f"{name}/pose", PoseUpdate), whereabouts
            poses, whereabouts = self._channels[name]
            poses.publish(PoseUpdate(tick.time, pose.x, pose.y, pose.yaw))
            whereabouts.publish(robot.whereabouts(tick.time))
            if name in self._places:
                self._places[name].see(pose)


def _groups(free: NDArray[np.bool_], ends: Iterable[tuple[int, int] | None]) -> int:
    """Return how many groups of ends there are between which no way leads."""
    from scipy.ndimage import label  # noqa: PLC0415 - slow to import

    numbers = label(free)[0]  # by sides alone, as paths, which go diagonally only past two open cells
    return len({int(numbers[end]) for end in ends if end is not None})


def _check(name: str, *, noise: float = 0.0, beams: int = 0, **numbers: float) -> None:
    """Check the numbers of a robot."""
    for what, number in numbers.items():
        if not is_number(number) or not 0 < number < math.inf:
            raise ConfigError(f"the {what} of robot {name!r} is a number above 0, not {number!r}", key=what)
    if not is_number(noise) or not 0 <= noise < math.inf:
        raise ConfigError(f"the noise of robot {name!r} is a number from 0, not {noise!r}", key="noise")
    if not is_whole(beams) or beams < 0:
        raise ConfigError(f"the beams of robot {name!r} are a whole number from 0, not {beams!r}", key="beams")


def _navground() -> tuple[Any, Any]:
    try:
        from navground import core, sim  # noqa: PLC0415 - an extra
    except ImportError:
        raise Error("simulated buildings need navground: pip install navground pillow pyyaml") from None
    return core, sim
