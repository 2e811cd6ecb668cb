"""Four simulated carriers, a process each: loads come by themselves, and one carrier at a time may unload."""

from __future__ import annotations

import asyncio
import random
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mdm

LOADED_AFTER = 3.0  # seconds, on average
UNLOADING = 0.5  # seconds


class Carrier:
    """A carrier that is loaded by chance.

    Args:
        name: The agent's name.
    """

    def __init__(self, name: str) -> None:
        self.random = random.Random(name)

    async def live(self, system: mdm.System) -> None:
        """Wait for a load, and then until it is gone, again and again."""
        self.predicates = system.predicates
        while True:
            self.gone = asyncio.Event()
            await asyncio.sleep(self.random.expovariate(1 / LOADED_AFTER))
            print("loaded", flush=True)
            self.predicates.sense("IsLoaded", True)
            await self.gone.wait()

    def wait(self) -> None:
        """Keep away from the dock."""

    async def unload(self) -> None:
        """Drive to the dock and unload; who is called away on the way keeps the load."""
        print("at the dock", flush=True)
        await asyncio.sleep(UNLOADING)
        print("unloaded", flush=True)
        self.gone.set()
        self.predicates.sense("IsLoaded", False)


a, b, c, d = (Carrier(name) for name in "abcd")
