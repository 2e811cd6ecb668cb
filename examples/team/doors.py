"""A simulated robot before two doors, behind one of which is a tiger."""

from __future__ import annotations

import asyncio
import random
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mdm

HEARD = 0.85  # how often the tiger is heard where it is


class Robot:
    """A robot that hears a tiger, not always where it is."""

    def __init__(self) -> None:
        self.random = random.Random(4)
        self.tiger = self.random.choice(["Left", "Right"])

    async def live(self, system: mdm.System) -> None:
        """Wait for actions."""
        self.predicates = system.predicates
        await asyncio.Event().wait()

    def listen(self) -> None:
        """Listen; what is heard decides what is done next."""
        other = "Right" if self.tiger == "Left" else "Left"
        heard = self.tiger if self.random.random() < HEARD else other
        print(f"listens, and hears the tiger at the {heard.lower()}", flush=True)
        self.predicates.occur(f"Heard{heard}")

    def open_left(self) -> None:
        """Open the left door."""
        self.open("Left")

    def open_right(self) -> None:
        """Open the right door."""
        self.open("Right")

    def open(self, door: str) -> None:
        """Open a door; then the next tiger is somewhere, and the noise says nothing of it."""
        found = "the tiger!" if door == self.tiger else "a treasure"
        print(f"opens the {door.lower()} door: {found}", flush=True)
        self.tiger = self.random.choice(["Left", "Right"])
        self.predicates.occur(self.random.choice(["HeardLeft", "HeardRight"]))


robot = Robot()
