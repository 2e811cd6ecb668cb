"""Random systems with random faults, from a seed, run in virtual time and held against oracles.

A scenario is a system (`chaos.system`) and what happens to it (`chaos.script`); a journal notes what it does, and the
oracles judge that. `Scenario.run` returns what they find wrong.
"""

from __future__ import annotations

import asyncio
import logging
import random
import threading
from pathlib import Path

from chaos.actions import Actions
from chaos.endless import Endless
from chaos.journal import HEARD, Journal
from chaos.oracles import SLACK, Oracles
from chaos.pool import Pool
from chaos.script import COMMANDS, STIMULI, Script
from chaos.system import Lively, System
from chaos.talker import Talker
from chaos.texts import Texts
from chaos.watchers import Watchers, difference

import mdm
from mdm.testing import probe

DESCRIPTORS = Path("/proc/self/fd")
WATCHED = 5
"""Of so many scenarios one is watched."""
END = 120.0
"""Seconds of virtual time in which everything is over once the runtime is left."""


class Witness(mdm.Actor):
    """Notes who is deciding when the runtime begins to end.

    Args:
        journal: Where.
    """

    def __init__(self, journal):
        super().__init__("witness")
        self._journal = journal

    def on_ending(self):
        self._journal.begins(self._journal.ends(self._journal.robots))


class Scenario:
    """A system and its script, drawn from a seed.

    Args:
        seed: The same seed makes the same scenario.
        watched: Whether it may be watched: what watches must change nothing.
    """

    def __init__(self, seed, *, watched=True):
        self.seed = seed
        self.random = random.Random(seed)
        self.pool = Pool()
        self.texts = Texts(random.Random(f"texts of {seed}"))
        self.journal = Journal(self.random, self.texts)
        self.endless = Endless(seed, self.journal)
        self.talker = Talker(random.Random(f"talk of {seed}"), self.journal, self.texts)
        self.watchers = Watchers(seed, self.journal) if watched and seed % WATCHED == 2 else None
        self.system = System(
            self.random, self.journal, Actions(self.random, self.journal, self.pool), Lively(seed, self.journal)
        )
        self.script = Script(self.random, self.system, self.journal)
        self.ended_by, self.broken_off = None, False

    def run(self):
        """Carry the scenario out, and return what is wrong, each in a sentence."""
        before = _threads_and_descriptors()
        try:
            with self.endless.patched():
                mdm.run(self._main, virtual=True)
            wrong = list(Oracles(self.journal, self.ended_by, broken_off=self.broken_off).judge())
            if self.watchers is not None:
                wrong += self.watchers.judge()
                wrong += self._changed()
        finally:
            if self.watchers is not None:
                self.watchers.close()
        after = _threads_and_descriptors()
        return wrong if after == before else [*wrong, f"threads and descriptors were {before}, and are {after}"]

    def _changed(self):
        """Yield what went otherwise than where nobody watches, unless turns were cut: a record has a say in where."""
        if self.endless.begun is not None:
            return
        alone = Scenario(self.seed, watched=False)
        alone.run()
        for name, seen, there in zip(HEARD, self.journal.heard(), alone.journal.heard(), strict=True):
            if seen != there:
                yield f"{name} with watchers differ: {difference(seen, there)}"

    async def _main(self):
        draw, loop = self.random, asyncio.get_running_loop()
        loop.set_default_executor(self.pool)
        loop._has_executor = True  # else virtual time takes one of its own
        self.afterwards = []
        host = asyncio.create_task(self._live())
        if draw.random() < 0.15:
            self.afterwards.append(asyncio.create_task(self._cancel(host)))
        await asyncio.wait([host])
        for task in self.afterwards:
            await task
        await asyncio.sleep(END)
        for task in self.script.tasks:
            if task.done():
                task.result()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            self.journal.wrong.append(f"tasks are left: {others}")

    async def _live(self):
        """Be the program: enter the runtime, let things happen, and leave it, here or in another task."""
        journal, draw = self.journal, self.random
        options = {"log": False} if self.watchers is None else self.watchers.options()
        runtime = journal.runtime = mdm.Runtime(**options)
        if self.watchers is not None:
            self.watchers.listen(runtime)
            self.script.meanwhile.append(self.watchers.look)
        elsewhere = draw.random() < 0.2
        began = None
        try:
            await runtime.__aenter__()
            error = None
            try:
                await self._happen(runtime)
                self.afterwards.append(asyncio.create_task(self.script.go(draw.randint(0, 10), STIMULI)))
            except BaseException as caught:
                error = caught
            began = journal.now()
            ending = journal.ends(journal.robots)
            if elsewhere:
                leaving = asyncio.create_task(_leave(runtime, error))
                await asyncio.wait([leaving])
                raised = leaving.result()
            else:
                raised = await _leave(runtime, error)
            journal.ended(ending)
            if raised is not None:
                raise raised
        except BaseException as error:
            self.ended_by = error
        took = asyncio.get_running_loop().time() - (began or 0) / 1e9
        limit = SLACK + sum(top.patience for top in self.system.tops)
        if began is not None and took > limit:
            journal.wrong.append(f"the end took {took:.1f} s, longer than {limit:.1f} s")

    async def _happen(self, runtime):
        journal, draw = self.journal, self.random
        journal.faults = probe(runtime.faults)
        runtime.faults.subscribe(journal.hear_fault)
        runtime.modes.subscribe(journal.hear_mode)
        runtime.decisions.subscribe(lambda decision: journal.decisions.append((journal.now(), decision)))
        runtime.lives.subscribe(journal.hear)
        self.script.open()
        for name in journal.robots:
            path = journal.path(name)
            journal.lives.append(probe(runtime.channel(f"{path}/lives", mdm.messages.ActionLife)))
            runtime.channel(f"{path}/lives", mdm.messages.ActionLife).subscribe(journal.hear_life)
        await runtime.start(Witness(journal))
        await runtime.start(self.talker)
        await self.endless.open(runtime)
        self.script.meanwhile.append(self.endless.step)
        for top in self.system.tops:
            if draw.random() < 0.2:
                await self.script.start(top, broken_off=True)
            else:
                await runtime.start(top)
        await self.script.go(draw.randint(8, 25), COMMANDS, draw.choice([0.0, 0.15, 0.25]))
        if draw.random() < 0.4:
            await self.script.hurry()

    async def _cancel(self, host):
        """Cancel the program, once or twice."""
        draw, runtime = self.random, None
        for _ in range(draw.choice([1, 1, 2])):
            await asyncio.sleep(draw.choice([0.0, 0.1, 1.0, 3.0, 20.0]))
            runtime = self.journal.runtime
            if host.done() or runtime is None:
                return
            self.broken_off = self.broken_off or runtime.ending
            host.cancel()


async def _leave(runtime, error):
    """Leave the block as `async with` does; return what it raises."""
    try:
        swallowed = await runtime.__aexit__(None if error is None else type(error), error, None)
    except BaseException as raised:
        return raised
    return None if swallowed else error


def _threads_and_descriptors():
    return threading.active_count(), len(list(DESCRIPTORS.iterdir())) if DESCRIPTORS.is_dir() else 0


def violations(seed):
    """Return a seed, and what is wrong with its scenario."""
    logging.disable()  # asyncio logs errors that nobody awaits, as is meant here
    return seed, Scenario(seed).run()
