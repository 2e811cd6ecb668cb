"""Turns that go on: actors and plain actions that lead to each other, for a while or without end."""

from __future__ import annotations

import asyncio
import random
from unittest.mock import patch

import msgspec

import mdm
from mdm.runtime import dispatcher

STEP = 300_000
"""Nanoseconds that a message of a circle takes where time passes."""
MOST = 3_000_000
"""Messages of a circle at one instant and while the runtime ends because of it."""
STARVED = 1.0
SLICE = 32
"""Messages from one look at the clock to the next, for 256."""
LATE = 0.2
"""Seconds that input waits, at most: two slices of a turn that is cut, and what is on the way."""
AT_ONCE = 3_000
"""Messages at one instant, for 100,000."""
EVERY = 0.1


class Spin(msgspec.Struct):
    left: int


class Pulse(msgspec.Struct):
    time: int


class Spinner(mdm.Actor):
    """Takes from one channel and publishes on another.

    Args:
        name: Its name.
        endless: Says whether it goes on.
        source: Where it takes from.
        target: Where it publishes.
    """

    def __init__(self, name, endless, source, target):
        super().__init__(name, supervision="stop")
        self._endless, self._source, self._target = endless, source, target

    def on_start(self):
        self.subscribe(self.runtime.channel(self._source, Spin), self._spin)

    def _spin(self, spin):
        if self._endless.passes(spin.left):
            self.runtime.channel(self._target, Spin).publish(Spin(spin.left - 1))


class Endless:
    """Draws a circle for some scenarios, sets it going, and holds what is promised against what happens meanwhile.

    Args:
        seed: The scenario's.
        journal: Is told of it.
    """

    def __init__(self, seed, journal):
        draw = self._random = random.Random(f"circles of {seed}")
        self._journal = journal
        self.kind = draw.choice(["one", "two", "lamp"]) if draw.random() < 0.12 else None
        self.stands = self.kind is not None and self.kind != "lamp" and draw.random() < 0.15
        self.left = draw.choice([1000, 4000, 10_000, 10_000, 10_000 if self.kind == "lamp" else 10**9])
        journal.slack = LATE if self.kind else 0.0
        self.going, self._passed = False, 0
        self.begun = self._first = None
        self._pulses, self._tasks = [], []
        self._lamp = self._lit = None

    def patched(self):
        """Return a context in which a circle is looked at more often, and less is taken for a standstill."""
        known = {"_AT_ONCE": AT_ONCE if self.stands else dispatcher._AT_ONCE}
        return patch.multiple(dispatcher, _SLICE=SLICE if self.kind else dispatcher._SLICE, **known)

    async def open(self, runtime):
        """Start the actors of a circle."""
        self._runtime = runtime
        if self.kind is None:
            return
        runtime.channel("pulse", Pulse).subscribe(self._feel)
        if self.kind == "lamp":
            manager = mdm.PredicateManager("lamps")
            self._lit = manager.sensor("Lit", initial=None)
            self._lamp = mdm.Ensemble(
                "lamp",
                policy=mdm.policies.DeterministicPolicy([0, 1], 2),
                predicates=manager,
                states=[mdm.StateFactor("lit", ["Lit"])],
                actions={"light": lambda: self._switch(on=True), "dim": lambda: self._switch(on=False)},
                safe_action=lambda: None,
                supervision="stop",
            )
            await runtime.start(self._lamp)
        else:
            names = ["spin"] if self.kind == "one" else ["spin", "spun"]
            for index, name in enumerate(names):
                await runtime.start(Spinner(name, self, name, names[(index + 1) % len(names)]))

    def _switch(self, *, on):
        if self.passes(self.left):
            self.left -= 1
            self._lit.set(on)

    def passes(self, left):
        """Let the time of one message pass; return whether there is another one."""
        self._passed += 1
        if self._passed == MOST:
            self._journal.wrong.append(f"{MOST:,} messages go round, and the runtime has not ended")
        self.going = left > 0 and self._passed < MOST
        if not self.stands:
            asyncio.get_running_loop()._virtual.now += STEP
        return self.going

    def step(self):
        """Set the circle going, once; or hold what must be when it has come to its end."""
        runtime = self._journal.runtime
        if self.kind is None or runtime.ending:
            return
        if self.begun is None:
            if self._random.random() < 0.3:
                self._begin(runtime)
        elif not runtime.dispatcher.active:
            for name, robot in self._journal.robots.items():
                if robot.life == "running" and any(cause.kind == "starved" for cause in robot.causes):
                    self._journal.wrong.append(f"{name} is starved, but nothing goes on")

    def _begin(self, runtime):
        self.begun = self._journal.now()
        self._tasks.append(asyncio.create_task(self._attend(runtime)))
        if self.kind != "lamp":
            runtime.channel("spin", Spin).publish(Spin(10**9 if self.stands else self.left))
        elif self._lamp.life == "running":
            self._lit.set(False)

    async def _attend(self, runtime):
        """Be other input."""
        while not runtime.ending:
            await asyncio.sleep(EVERY)
            if runtime.ending or self.stands:
                return
            if not (self.going and runtime.dispatcher.active):
                break
            now = self._journal.now()
            self._first = self._first or now
            self._hold(now)
            self._pulses.append(now)
            runtime.channel("pulse", Pulse).publish(Pulse(now))
        await asyncio.sleep(LATE)
        if self._pulses and not runtime.ending:
            self._journal.wrong.append(f"input of {self._pulses[0] / 1e9:.1f} s was never taken")

    def _feel(self, pulse):
        self._pulses.remove(pulse.time)

    def _hold(self, now):
        """Hold that input comes soon, and that whoever decides has gone safe where it has waited for too long."""
        if self._pulses and now - self._pulses[0] > LATE * 1e9:
            self._journal.wrong.append(f"input of {self._pulses[0] / 1e9:.1f} s waits at {now / 1e9:.1f} s")
        if now - self._first < (STARVED + LATE) * 1e9:
            return
        faults = [fault for fault in self._journal.faults if fault.kind == "starved" and fault.time >= self._first]
        if not faults:
            self._journal.wrong.append(f"a turn goes on since {self.begun / 1e9:.1f} s, and nobody is starved")
            return
        for name, robot in self._journal.robots.items():
            told = [mode for mode in self._journal.modes if mode.ensemble == self._journal.path(name)]
            since = [mode for mode in told if mode.time >= faults[0].time]
            lives = robot.life == "running" and not robot.failing
            if lives and robot.mode == "deciding" and not since and told[-1].time < self.begun:
                self._journal.wrong.append(f"{name} decides at {now / 1e9:.1f} s, while a turn goes on")
