"""Random systems in virtual time: everything that is published, every fault's words, and the statistics."""

from __future__ import annotations

import asyncio

from replay.systems import System

import mdm
from mdm.testing import run_virtual

SECONDS = 0.6
PLAIN = {"slow": "set", "thread": "sleep", "generator": "raise"}  # no threads, no addresses in texts


class Calm(System):
    """A random system without threads, whose time is virtual."""

    def _function(self, action, kind, *, lasting=None):
        return super()._function(action, PLAIN.get(kind, kind), lasting=lasting)

    async def run(self, runtime, seconds):
        """Start everything, and let things happen for so many seconds."""
        draw = self.behaviour
        self.runtime = runtime
        for top in self.tops:
            await runtime.start(top)
        self.steady.publish_state(0)
        task = asyncio.create_task(self._walk())
        until = runtime.clock.time() + seconds
        while runtime.clock.time() < until:
            await asyncio.sleep(draw.choice([0, 0.001, 0.004, 0.01]))
            self._happen()
        task.cancel()

    def _happen(self):
        chance = self.behaviour.random()
        if chance < 0.06:
            self.command()
        elif chance < 0.07 and self.crashes:
            mdm.testing.crash(self.behaviour.choice([*self.ensembles, self.manager]), ValueError("as meant"))
        else:
            self.say()


def listening(runtime, heard):
    """Note as texts what is published on the channels of a runtime."""
    for channel in (runtime.decisions, runtime.lives, runtime.modes, runtime.faults):
        channel.subscribe(lambda message: heard.append(str(message)))


def seen(seed, _, **options):
    """Return what the system of a seed does."""
    heard = []

    async def main(runtime):
        listening(runtime, heard)
        system = Calm(seed, behaviour=f"behaviour of {seed}")
        try:
            await system.run(runtime, SECONDS)
        finally:
            heard.extend(f"{each.path} {each.statistics()}" for each in system.ensembles if each.life == "running")

    try:
        run_virtual(main, log=False, **options)
    except Exception as error:
        heard.append(f"{type(error).__name__}: {error}")
    return heard
