"""Two simulated robots, a process each: they share the patrol of a floor.

Each process simulates the floor with its own robot. Where that is it tells the other one ten times a second, which has
it as a body that moves: the robots keep clear of each other, and give way.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from mdm.maps import Map
from mdm.simulation.building import Building, Whereabouts
from mdm.team import Exports, Imports

if TYPE_CHECKING:
    import mdm
    from mdm.maps import Pose
    from mdm.simulation.building import Robot

SPEED, NOISE = 1.0, 0.05  # metres a second; metres that its poses are wrong by


class Guard:
    """A robot on a floor that it shares. It is a navigator: the ways and places of the map are its actions.

    Args:
        name: The agent's name.
        room: Where it begins.
        seed: Of the errors of its poses.
    """

    building: Building
    robot: Robot

    def __init__(self, name: str, room: str, seed: int) -> None:
        self.name = name
        self.room = room
        self.seed = seed

    async def live(self, system: mdm.System) -> None:
        """Put the robot on the file's floor, where it tells the places its poses; the other one is a guest there."""
        assert system.places is not None
        assert system.member is not None
        assert isinstance(system.places.floor, Map)
        self.building = building = Building(system.places.floor, seed=self.seed)
        for guard in (ada, bob):  # in one order in both processes: of two who meet the later one gives way first
            if guard is self:
                self.robot = building.robot(self.name, at=self.room, places=system.places, speed=SPEED, noise=NOISE)
            else:
                building.guest(guard.name)
        here = Exports(system.member.link, {f"building/{self.name}/whereabouts": Whereabouts})
        others = {f"{name}/building/{name}/whereabouts": guest for name, guest in building.guests.items()}
        there = Imports(system.member.link, dict.fromkeys(others, Whereabouts))
        for actor in (building, here, there):
            await system.runtime.start(actor)
        for channel, guest in others.items():
            there.imported(channel).subscribe(guest.take)
        await asyncio.Event().wait()

    async def go(self, goal: Pose) -> None:
        """Drive to a pose."""
        print(f"drives to {goal.x:g}, {goal.y:g}", flush=True)
        await self.robot.go(goal)

    def drive(self) -> Guard:
        """Return what drives the robot: itself."""
        return self


def stay() -> None:
    """Stand still: the drive that was under way has been cancelled."""


ada = Guard("ada", "SouthCorridor", seed=1)
bob = Guard("bob", "ElevatorHallway", seed=2)
