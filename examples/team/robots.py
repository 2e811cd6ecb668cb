"""Two simulated robots, a process each: they patrol both wings, and meet in the hall when there is news."""

from __future__ import annotations

import asyncio
import random
from typing import TYPE_CHECKING

from make_models import MOVED, NEWS, RECOGNISED, ROOMS

if TYPE_CHECKING:
    import mdm

LOOKING = 0.2  # seconds


class Robot:
    """A robot that moves between rooms, and takes one for another at times.

    Args:
        name: The agent's name.
        room: Where it begins.
    """

    def __init__(self, name: str, room: str) -> None:
        self.name = name
        self.room = ROOMS.index(room)
        self.news = False
        self.random = random.Random(name)

    async def live(self, system: mdm.System) -> None:
        """Tell where the robot is, which the other needs to know for a meeting, and wait for actions."""
        self.predicates = system.predicates
        self.predicates.sense("InHall", ROOMS[self.room] == "Hall")
        await asyncio.Event().wait()

    async def go_west(self) -> None:
        """Go one room to the west."""
        await self.move(-1)

    async def stay(self) -> None:
        """Stay."""
        await self.move(0)

    async def go_east(self) -> None:
        """Go one room to the east."""
        await self.move(1)

    async def move(self, step: int) -> None:
        """Move, look around, and say what is seen, which is decided on at the next step."""
        if self.random.random() < MOVED:
            self.room = min(max(self.room + step, 0), len(ROOMS) - 1)
        self.predicates.sense("InHall", ROOMS[self.room] == "Hall")
        await asyncio.sleep(LOOKING)  # meanwhile the other robot has come, or not
        if self.predicates.value("Together"):
            self.news = False
        elif self.name == "ada" and self.random.random() < NEWS:
            self.news = True
        print(f"in the {ROOMS[self.room]}{', with news' if self.news else ''}", flush=True)
        self.predicates.occur(f"Sees{self.look()}")

    def look(self) -> str:
        """Return what the robot takes the room for, or that there is news."""
        if self.news and self.random.random() < 0.5:
            return "News"
        if self.random.random() < RECOGNISED:
            return ROOMS[self.room]
        return self.random.choice([room for room in ROOMS if room != ROOMS[self.room]])


ada = Robot("ada", "West")
bob = Robot("bob", "East")
