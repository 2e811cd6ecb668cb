"""The tower: several floors, each a building, and robots that take the lifts between them."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ConfigError, MapError
from mdm.messages import PoseUpdate
from mdm.runtime import Actor
from mdm.simulation.building.building import Building
from mdm.simulation.building.robot import DriveError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mdm.maps import Floors, Pose
    from mdm.maps.places import Places
    from mdm.messages import Tick
    from mdm.runtime import Channel
    from mdm.simulation.building.robot import Robot
    from mdm.simulation.building.visits import Visits

_RATE = 10.0
"""Times a second at which robots tell their poses."""
_BOARDS = 1.0
"""Metres from a lift's stop within which a robot gets in."""
_PATIENCE = 30.0
"""Seconds for which a robot waits until there is room to get out."""


class Tower(Actor):
    """Several floors, each a `Building` of its own, and robots that drive on them and take the lifts between them.

    Of a lift there is one, which takes one robot at a time; others wait for it inside, in nobody's way. The same seed
    gives the same run in virtual time.

    Args:
        floors: The floors, each with its grid, and the lifts.
        visits: The visits to each floor, by its name, to places by their names there.
        seed: The seed of all that is random.
        name: Its name among actors.

    Raises:
        MapError: If a floor has no grid.
        ConfigError: If there are visits to a floor that there is not.
        Error: If navground is not installed.

    Attributes:
        floors: The floors and lifts.
        buildings: The building of each floor, by its name.
        robots: The robots by name.

    Example::

        floors = mdm.maps.load_floors("building.toml")
        tower = Tower(floors, seed=1)
        robot = tower.robot("ada", at="ground.Hall")
    """

    def __init__(
        self,
        floors: Floors,
        *,
        visits: Mapping[str, Iterable[Visits]] | None = None,
        seed: int | None = None,
        name: str = "building",
    ) -> None:
        super().__init__(name)
        unknown = [floor for floor in visits or {} if floor not in floors.maps]
        if unknown:
            raise ConfigError(f"there is no floor {unknown[0]!r}; there are {', '.join(floors.maps)}", key="visits")
        self.floors = floors
        seeds = np.random.SeedSequence(seed).generate_state(len(floors.maps)).tolist()
        self.buildings = {
            floor: Building(each, visits=(visits or {}).get(floor, ()), seed=number, name=floor)
            for (floor, each), number in zip(floors.maps.items(), seeds, strict=True)
        }
        self.robots: dict[str, Rider] = {}
        self._places: dict[str, Places] = {}
        self._channels: dict[str, Channel[PoseUpdate]] = {}
        self._shafts: dict[str, asyncio.Lock] = {}
        for building in self.buildings.values():
            self.add(building)

    def robot(self, name: str, *, at: str | Pose, places: Places | None = None, **options: Any) -> Rider:
        """Put a robot on a floor, before or after it starts. Its poses are told on ``<tower>/<name>/pose``.

        Args:
            name: Its name.
            at: Where it begins: a place, at its goal, or a pose with its floor.
            places: Told of its poses, too.
            options: As of `Building.robot`: ``radius``, ``speed``, ``noise``, ``beams``, ``reach``.

        Raises:
            ConfigError: If there is a robot of that name, or an option is none.
            MapError: If it does not fit there, or there is no such place or floor.
        """
        start = self.floors.graph.node(at).goal if isinstance(at, str) else at
        if start.floor not in self.buildings:
            raise MapError(f"robot {name!r} begins on the floor {start.floor!r}; there are {', '.join(self.buildings)}")
        first = self.buildings[start.floor].robot(name, at=start, **options)
        robots = {start.floor: first}
        for floor, building in self.buildings.items():
            if floor != start.floor:
                robots[floor] = building.robot(name, at=None, **options)
        self.robots[name] = rider = Rider(self, {floor: robots[floor] for floor in self.buildings}, start.floor)
        if places is not None:
            self._places[name] = places
        return rider

    def on_start(self) -> None:
        """Begin to tell poses."""
        self._channels = {}
        self._shafts = {}
        self.every(_RATE, self._tell)

    def shaft(self, lift: str) -> asyncio.Lock:
        """Return the lock that a robot holds in a lift under way."""
        return self._shafts.setdefault(lift, asyncio.Lock())

    def _tell(self, tick: Tick) -> None:
        for name, robot in self.robots.items():
            pose = robot.estimate()
            if name not in self._channels:
                self._channels[name] = self.channel(f"{name}/pose", PoseUpdate)
            self._channels[name].publish(PoseUpdate(tick.time, pose.x, pose.y, pose.yaw, pose.floor))
            if name in self._places:
                self._places[name].see(pose)


class Rider:
    """A robot of a `Tower`, which makes it. It is a navigator that takes lifts: `go` on its floor, `ride` to others.

    Args:
        tower: Where it is.
        robots: Its body on each floor.
        floor: Where it begins.

    Attributes:
        name: Its name.
        floor: The floor where it is; while it rides, the one that it comes from.
    """

    def __init__(self, tower: Tower, robots: Mapping[str, Robot], floor: str) -> None:
        self.name = robots[floor].name
        self.floor = floor
        self._tower = tower
        self._robots = robots
        self._inside: Pose | None = None  # in a lift: where it gets out

    @property
    def robot(self) -> Robot:
        """Its body on the floor where it is."""
        return self._robots[self.floor]

    @property
    def rides(self) -> bool:
        """Whether it is in a lift."""
        return self._inside is not None

    @property
    def pose(self) -> Pose:
        """Where it really is; in a lift, before the stop on its floor."""
        return self._inside or replace(self.robot.pose, floor=self.floor)

    @property
    def collisions(self) -> int:
        """In how many steps it has touched something, on all floors."""
        return sum(robot.collisions for robot in self._robots.values())

    def estimate(self) -> Pose:
        """Return where it believes to be: its pose with noise; its floor it knows."""
        return replace(self.robot.estimate(self._inside), floor=self.floor)

    async def go(self, goal: Pose) -> None:
        """Drive to a pose on the floor where it is, out of the lift first where it is in one.

        Raises:
            DriveError: If the goal is on another floor, or it cannot get there or out.
        """
        if goal.floor != self.floor:
            raise DriveError(f"robot {self.name!r} is on {self.floor!r}, and cannot drive to {goal.floor!r}: it rides")
        if self._inside is not None:
            await self._get_out()
        await self.robot.go(goal)

    async def ride(self, lift: str, goal: Pose) -> None:
        """Take a lift to its stop on another floor. Where that is cancelled, it is in the lift on its own floor.

        Raises:
            DriveError: If the lift does not lead there from where the robot is, or nobody lets it out.
        """
        taken, stops = self._stops(lift, goal)
        if self._inside is None:
            here = self.robot.pose
            if math.dist((here.x, here.y), (stops[0].x, stops[0].y)) > _BOARDS:
                raise DriveError(f"robot {self.name!r} is at {here.x:.2f}, {here.y:.2f}, and not before {lift!r}")
            self._tower.buildings[self.floor].leave(self.name)
        self._inside = stops[0]
        async with self._tower.shaft(lift):
            await self._tower.runtime.clock.sleep(taken)
            self.floor, self._inside = goal.floor, stops[1]
            await self._get_out()

    async def _get_out(self) -> None:
        """Stand before the lift, once nobody else does."""
        assert self._inside is not None
        building, clock = self._tower.buildings[self.floor], self._tower.runtime.clock
        for _ in range(round(_PATIENCE * _RATE)):
            if building.enter(self.name, self._inside):
                self._inside = None
                return
            await clock.sleep(1 / _RATE)
        raise DriveError(f"robot {self.name!r} cannot get out on {self.floor!r}: somebody stands before the lift")

    def _stops(self, name: str, goal: Pose) -> tuple[float, tuple[Pose, Pose]]:
        """Return the seconds that a lift takes from the robot's floor to a goal's, and its stops on both."""
        for way in self._tower.floors.graph.edges:
            if way.lift == name and way.seconds is not None:
                ends = tuple(self._tower.floors.graph.node(end).goal for end in (way.source, way.target))
                if (ends[0].floor, ends[1].floor) == (self.floor, goal.floor):
                    return way.seconds, (ends[0], ends[1])
        raise DriveError(f"no lift {name!r} takes robot {self.name!r} from {self.floor!r} to {goal.floor!r}")
