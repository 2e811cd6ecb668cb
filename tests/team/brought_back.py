"""Teams of real processes that are stopped, killed and brought back: ``python -m team.brought_back COUNT [FIRST]``.

A seed draws the mode, whether some agents are killed while they confirm a stop, and in which order and how fast all are
killed and brought back. No robot may begin an action between a stop that it confirmed and the next start, whatever its
process; and when all have confirmed, nobody does until a start, which all then carry out.
"""

from __future__ import annotations

import asyncio
import signal
import sys
import tempfile

from peers import peers
from team.commanded import LEASE, NAMES, PROGRAM, STILL, Robot, Schedule, main
from team.copies import Violation
from team.test_processes import endpoints

from mdm.team.sharing.calls import asking
from mdm.team.team import Team

TRIES = 5
"""Stops that are said until all have confirmed one."""


class Return(Schedule):
    """One run, drawn from a seed."""

    async def run(self):
        self.agents = endpoints(NAMES)
        self.team = Team("team", self.agents, period=0.1, lease=LEASE, mode=self.mode)
        self.robots = {}
        with tempfile.TemporaryDirectory() as self.folder:
            async with peers(PROGRAM) as self.process, asking(self.team) as (self.session, _):
                try:
                    await self.up(NAMES)
                    return await self.befall()
                finally:
                    for robot in self.robots.values():
                        robot.reading.cancel()

    async def befall(self):
        await self.moving(NAMES)
        if self.random.random() < 0.6:
            await self.kill_while_confirming()
        for _ in range(TRIES):
            if all(one.confirmed for one in await self.say("stop", NAMES, seconds=10.0)):
                break
        else:
            raise Violation("not all have confirmed a stop")
        await self.kill(self.random.sample(NAMES, 3))
        await self.up(self.random.sample(NAMES, 3))
        await asyncio.sleep(STILL)
        self.check()
        for _ in range(TRIES):
            if all(one.confirmed for one in await self.say("start", NAMES, seconds=10.0)):
                break
        await self.moving(NAMES)

    async def kill_while_confirming(self):
        victims = self.random.sample(NAMES, self.random.randrange(1, 4))
        told = asyncio.create_task(self.say("stop", NAMES))
        await asyncio.sleep(self.random.uniform(0.0, 0.3))
        await self.kill(victims)
        await told
        await self.up(victims)
        await asyncio.sleep(self.random.choice([0.0, STILL]))
        self.check()

    async def kill(self, names):
        self.log.append(("kill", names))
        for name in names:
            self.robots[name].peer.signal(signal.SIGKILL)
            await asyncio.sleep(self.random.choice([0.0, 0.0, 0.1, 3 * LEASE]))
        for name in names:
            await self.robots[name].peer.end()
            await self.robots[name].reading

    async def up(self, names):
        self.log.append(("up", names))
        for name in names:
            options = {"mode": self.mode, "lease": LEASE, "state": self.folder}
            robot = Robot(await self.process(agent=name, agents=self.agents, **options))
            if name in self.robots:
                robot.began = self.robots[name].began + robot.began
            self.robots[name] = robot
            await asyncio.sleep(self.random.choice([0.0, 0.0, 0.3]))
        for name in names:
            await self.robots[name].hear(running=name)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:]), schedule=Return))
