"""Teams of real processes that are cut off, commanded and healed: ``python -m team.commanded COUNT [FIRST]``.

What is done is drawn from the seed: who is cut off when, who is asked to start or to stop, all or some of the agents.
Each stop that an agent confirms has a time, and so has each start that is asked for; no robot may begin an action
between a stop that it confirmed and the next start. At the end all are stopped, and healed, and none may move.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from random import Random

from patience import PATIENCE
from peers import peers
from places import ROOT
from team.copies import Violation
from team.test_processes import endpoints

from mdm.team.sharing.calls import asking
from mdm.team.sharing.commanding import command
from mdm.team.team import Team

PROGRAM = ROOT / "tests" / "commanded_program.py"
MODES = ("replicated", "centralised", "communicating")
NAMES = ("r0", "r1", "r2")
LEASE = 0.5
STILL = 4 * LEASE
"""Seconds after healing in which nobody may move."""


class Robot:
    """One process, and when its actions began."""

    def __init__(self, peer):
        self.peer = peer
        self.began = []
        self.events = asyncio.Queue()
        self.reading = asyncio.create_task(self.read())

    async def read(self):
        while line := await self.peer.process.stdout.readline():
            event = json.loads(line)
            if "began" in event:
                self.began.append(event["began"])
            else:
                self.events.put_nowait(event)

    async def hear(self, **wanted):
        async with asyncio.timeout(PATIENCE):
            while await self.events.get() != wanted:
                pass

    async def cut(self, cut):
        self.peer.tell(cut=cut)
        await self.hear(cut=cut)


class Schedule:
    """One run, drawn from a seed."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.mode = MODES[seed % len(MODES)]
        self.starts = []
        self.stops = []
        self.log = []

    async def run(self):
        agents = endpoints(NAMES)
        self.team = Team("team", agents, period=0.1, lease=LEASE, mode=self.mode)
        async with peers(PROGRAM) as start:
            self.robots = {}
            for name in NAMES:
                peer = await start(agent=name, agents=agents, mode=self.mode, lease=LEASE)
                self.robots[name] = Robot(peer)
            try:
                for name in NAMES:
                    await self.robots[name].hear(running=name)
                async with asking(self.team) as (self.session, _):
                    return await self.befall()
            finally:
                for robot in self.robots.values():
                    robot.reading.cancel()

    async def befall(self):
        random, cut = self.random, None
        await self.moving(NAMES)
        for _ in range(random.randrange(2, 6)):
            if cut is None and random.random() < 0.6:
                cut = random.choice(NAMES)
                await self.robots[cut].cut(True)
                await asyncio.sleep(random.choice([0.1, 3 * LEASE]))
            elif cut is not None and random.random() < 0.4:
                await self.robots[cut].cut(False)
                cut = None
                await asyncio.sleep(random.choice([0.0, 3 * LEASE]))
            some = random.choice([NAMES, NAMES, (random.choice(NAMES),), (cut or "r0",)])
            await self.say(random.choice(["start", "start", "stop", "reset"]), some)
        if cut is None:
            cut = random.choice(NAMES)
            await self.robots[cut].cut(True)
            await asyncio.sleep(random.choice([0.1, 3 * LEASE]))
        if random.random() < 0.7:
            await self.say("start", (cut,))
        told = await self.say("stop", NAMES)
        if not all(one.confirmed for one in told):
            raise Violation(f"not all have confirmed the last stop: {told}")
        await self.robots[cut].cut(False)
        await asyncio.sleep(STILL)
        self.check()
        await self.say("start", NAMES, seconds=10.0)
        await self.moving(NAMES)  # who never moves again has not been held, but lost

    async def moving(self, names):
        """Wait until all these act."""
        before = {name: len(self.robots[name].began) for name in names}
        async with asyncio.timeout(PATIENCE):
            while any(len(self.robots[name].began) == before[name] for name in names):
                await asyncio.sleep(0.02)

    async def say(self, name, agents, seconds=3.0):
        """Say a command to some of the agents; keep when, and who confirmed."""
        self.log.append((name, agents))
        if name == "start":
            self.starts.append(time.monotonic_ns())
        told = await command(self.session, self.team, name, agents=agents, seconds=seconds)
        if name == "stop":
            now = time.monotonic_ns()
            self.stops += ((now, one.agent) for one in told if one.confirmed)
        return told

    def check(self):
        for stopped, name in self.stops:
            until = min((start for start in self.starts if start > stopped), default=time.monotonic_ns())
            moved = [began for began in self.robots[name].began if stopped < began < until]
            if moved:
                after = (moved[0] - stopped) / 1e9
                raise Violation(f"{name} moves {len(moved)} times, {after:.3f} s after it confirmed a stop: {self.log}")


def violation(seed, schedule=Schedule):
    """Return the mode of a seed's schedule, the stops that were confirmed in it, and what is violated."""
    drawn, wrong = schedule(seed), None
    try:
        asyncio.run(drawn.run())
    except (Violation, TimeoutError) as found:
        wrong = f"{type(found).__name__}: {found} {drawn.log}"
    return drawn.mode, len(drawn.stops), wrong


def main(count, first=0, schedule=Schedule):
    """Run the schedules of so many seeds one after the other, and return the exit status."""
    began, wrong, stops = time.monotonic(), 0, 0
    for seed in range(first, first + count):
        mode, confirmed, found = violation(seed, schedule)
        stops += confirmed
        wrong += found is not None
        print(f"seed {seed}, {mode}: {found or 'nobody moved'}", flush=True)
    print(f"{count} schedules, {stops} confirmed stops, {wrong} violate: {time.monotonic() - began:.0f} s", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
