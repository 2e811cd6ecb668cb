"""A simulated building: one robot that drives and sees, people and intruders that come and go, fires.

A real robot's code would stand in its place: sensors that set predicates and raise events, and async functions that
move the robot and can be cancelled at any ``await``.
"""

from __future__ import annotations

import asyncio
import random
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    import mdm

DRIVE = 1.0  # seconds from room to room
ROOMS = ("Lobby", "Office", "Lab")

Tell = "Callable[[str], None]"


class Building:
    """What is where. ``tell`` is called with a sentence for everything that happens."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.room = "Lobby"
        self.fire: str | None = None
        self.system: mdm.System | None = None
        self.tell: Callable[[str], None] = lambda _: None

    def sense(self, predicate: str, value: bool) -> None:
        """Set a predicate, as a sensor's driver would."""
        assert self.system is not None
        self.system.predicates.sense(predicate, value)

    async def drive(self, room: str) -> None:
        """Drive to a room; leaves the robot where it is when cancelled on the way."""
        if room != self.room:
            await asyncio.sleep(DRIVE)
            self.room = room

    def look(self) -> None:
        """Raise what the camera sees in this room; it is wrong now and then."""
        assert self.system is not None
        smoke = self.random.random() < (0.85 if self.fire == self.room else 0.1)
        self.system.predicates.occur("SeesSmoke" if smoke else "SeesClear")


building = Building(seed=4)


async def live(system: mdm.System) -> None:
    """What happens in the building, at its times."""
    building.system = system
    await asyncio.sleep(4)
    building.tell("a person presses the call button in the lobby")
    building.sense("PersonIsWaiting", True)
    await asyncio.sleep(6)
    building.fire = "Lab"
    building.tell("a fire breaks out in the lab; nobody knows yet")
    await asyncio.sleep(10)
    building.tell("a camera sees an intruder, and a person presses the button")
    with system.predicates.batch():
        building.sense("IntruderIsSeen", True)
        building.sense("PersonIsWaiting", True)


# -- Actions of the top level ------------------------------------------------------------------------------------


async def assist() -> None:
    """Drive to the person and help."""
    await building.drive("Lobby")
    await asyncio.sleep(1.5)
    building.tell("the person has been helped and leaves")
    building.sense("PersonIsWaiting", False)


async def warn_intruder() -> None:
    """Warn the intruder until they leave."""
    await asyncio.sleep(2.0)
    building.tell("the intruder runs away")
    building.sense("IntruderIsSeen", False)


async def fight_fire() -> None:
    """Drive to the fire and put it out."""
    if building.fire is not None:
        await building.drive(building.fire)
    await asyncio.sleep(2.0)
    building.tell("there was no fire" if building.fire is None else "the fire is out")
    building.fire = None


def stop_motors() -> None:
    """Stand still, whatever else happens."""
    building.tell("the robot's motors are off")


# -- Actions of the patrol ---------------------------------------------------------------------------------------


async def go_lobby() -> None:
    """Drive to the lobby and look."""
    await _go("Lobby")


async def go_office() -> None:
    """Drive to the office and look."""
    await _go("Office")


async def go_lab() -> None:
    """Drive to the lab and look."""
    await _go("Lab")


async def _go(room: str) -> None:
    if room == building.room:
        await asyncio.sleep(DRIVE / 2)  # turn around once
    await building.drive(room)
    building.look()


async def report_fire() -> None:
    """Call for help; that it has succeeded is what confirms the fire."""
    await asyncio.sleep(0.5)
