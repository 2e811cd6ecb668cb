"""Seeded schedules in virtual time: stops, kills while agents confirm them, and all killed and brought back.

`team.brought_back` has the same with real processes.
"""

from __future__ import annotations

import asyncio
from random import Random

from team.sharing.test_commanding_outcomes import MODES, NAMES
from team.test_storage import Keeping


class Schedule(Keeping):
    """Robots whose processes end as a seed says."""

    def __init__(self, runtime, seed, folder):
        super().__init__(runtime, MODES[seed % 3], folder)
        self.random = Random(seed)
        self.log = []

    async def end(self, names):
        """End the processes of some, one after the other, or at once."""
        for name in names:
            self.log.append(f"kill {name}")
            self.network.crash(name)
            stopping = asyncio.ensure_future(self.runtime.stop(self.robots[name].member))
            await asyncio.sleep(self.random.choice([0.0, 0.0, 0.1, 2.0]))
            await stopping

    async def bring_back(self, names):
        for name in names:
            self.log.append(f"up {name}")
            await self.up_soon(name)
        await asyncio.sleep(3.0)

    async def up_soon(self, name):
        before = self.robots[name].did
        await self.up(name, seconds=self.random.choice([0.0, 0.0, 0.3, 2.0]))
        self.robots[name].did[:0] = before

    async def interrupted_stop(self, asker):
        """Stop while some are killed; who confirmed moves no more."""
        victims = self.random.sample(NAMES, self.random.randrange(1, 4))
        told = asyncio.ensure_future(self.team.stop(transport=asker, seconds=3.0))
        await asyncio.sleep(self.random.choice([0.0, 0.001, 0.005, 0.05, 0.3]))
        await self.end(victims)
        confirmed = [one.agent for one in await told if one.confirmed]
        before = {name: len(self.robots[name].did) for name in confirmed}
        await self.bring_back(victims)
        await asyncio.sleep(self.random.choice([0.0, 3.0]))
        for name in confirmed:
            assert len(self.robots[name].did) == before[name], (name, self.log)

    async def befall(self, asker):
        if self.random.random() < 0.6:
            await self.interrupted_stop(asker)
        assert all(one.confirmed for one in await self.team.stop(transport=asker)), self.log
        before = {name: len(self.robots[name].did) for name in NAMES}
        await self.end(self.random.sample(NAMES, 3))
        await self.bring_back(self.random.sample(NAMES, 3))
        assert {name: len(self.robots[name].did) for name in NAMES} == before, self.log
        assert all(one.confirmed for one in await self.team.start(transport=asker)), self.log
        assert all(await self.begun(3.0)), self.log
