"""Two simulated robots, a process each: they share the patrol of a floor, and each simulates it with itself alone."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from mdm.maps import Map
from mdm.simulation.building import Building

if TYPE_CHECKING:
    import mdm
    from mdm.maps import Pose
    from mdm.simulation.building import Robot

SPEED, NOISE = 1.0, 0.05  # metres a second; metres that its poses are wrong by


class Guard:
    """A robot on a floor of its own. It is a navigator: the ways and places of the map are its actions.

    Args:
        name: The agent's name.
        room: Where it begins.
        seed: Of the errors of its poses.
    """

    robot: Robot

    def __init__(self, name: str, room: str, seed: int) -> None:
        self.name = name
        self.room = room
        self.seed = seed

    async def live(self, system: mdm.System) -> None:
        """Put the robot on the file's floor, where it tells the places its poses."""
        assert system.places is not None
        assert isinstance(system.places.floor, Map)
        building = Building(system.places.floor, seed=self.seed)
        self.robot = building.robot(self.name, at=self.room, places=system.places, speed=SPEED, noise=NOISE)
        await system.runtime.start(building)
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
