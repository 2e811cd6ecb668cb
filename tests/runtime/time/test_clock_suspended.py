"""A machine that was suspended: when it goes on, what is too old is so at once, and a replay decides the same."""

from __future__ import annotations

import asyncio
import time

import pytest
from patience import PATIENCE

from mdm import Ensemble, PredicateManager, Runtime, StateFactor, WallClock, run
from mdm.runtime.time import clock as clocks
from mdm.testing import probe, replay

HOUR = 3600


class Suspension:
    """Has the machine seem to have been suspended."""

    def __init__(self, monkeypatch):
        self.seconds, self.asked = 0.0, 0
        shown = clocks.suspended

        def suspended():
            self.asked += 1
            return shown() + round(self.seconds * 1e9)

        monkeypatch.setattr(clocks, "suspended", suspended)

    def end(self, clock, seconds):
        """Have the machine go on after so many seconds; as no test may set the time, the timer runs out."""
        self.seconds = seconds
        clocks.set_time(clock._resumes, time.time_ns())


@pytest.fixture
def suspension(monkeypatch):
    return Suspension(monkeypatch)


def patrol():
    """Return a sensor whose values hold for ten minutes, and a robot that drives while that says "free"."""
    manager = PredicateManager()
    free = manager.sensor("Free", max_age=600.0)
    manager.define("Blocked", "not Free")
    ensemble = Ensemble(
        "robot",
        policy=[0, 1],
        actions={"Drive": lambda: None, "Wait": lambda: None},
        predicates=manager,
        states=[StateFactor("way", ["Free", "Blocked"])],
        safe_action=lambda: None,
    )
    return free, ensemble


async def resumed(runtime, suspension, seconds):
    told = asyncio.Event()
    runtime.faults.subscribe(lambda fault: told.set() if fault.kind == "suspended" else None)
    suspension.end(runtime.clock, seconds)
    await asyncio.wait_for(told.wait(), PATIENCE)


@pytest.mark.parametrize("uvloop", [False, True])
def test_what_is_too_old_after_a_suspension_is_unknown_and_a_replay_decides_the_same(suspension, tmp_path, uvloop):
    if uvloop:
        pytest.importorskip("uvloop")
    path = tmp_path / "run.mcap"

    async def main():
        async with Runtime(log=None, record=path) as runtime:
            free, ensemble = patrol()
            faults, decisions = probe(runtime.faults), probe(runtime.decisions)
            await runtime.start(ensemble)
            free.set(True)
            before = runtime.clock.now()
            await resumed(runtime, suspension, HOUR)
            known = ensemble.predicates.value("Free"), ensemble.mode, runtime.clock.now() - before >= HOUR * 1e9
            free.set(True)
            return known, [fault.kind for fault in faults], [each.action for each in decisions]

    known, kinds, actions = run(main, uvloop=uvloop)
    assert known == (None, "safe", True)
    assert sorted(kinds) == ["stale", "stale_input", "suspended"]
    assert actions == [0, 0]
    assert replay(path, patrol()[1]) == 2


def test_a_short_suspension_makes_nothing_unknown(suspension):
    async def main():
        async with Runtime(log=None) as runtime:
            free, ensemble = patrol()
            await runtime.start(ensemble)
            free.set(True)
            await resumed(runtime, suspension, 300.0)
            return ensemble.predicates.value("Free"), ensemble.mode

    assert run(main) == (True, "deciding")


def test_the_clocks_of_sessions_leap_with_the_runtime_s_and_timers_that_are_due_by_then_fire(suspension):
    async def main():
        async with Runtime(log=None) as runtime:
            session = WallClock()
            read, fired = session.reader(), []
            runtime.clock.call_at(runtime.clock.now() + HOUR * 10**9, lambda: fired.append(True))
            suspension.seconds = HOUR + 1.0
            late = WallClock()  # it began when the machine went on
            await resumed(runtime, suspension, suspension.seconds)
            await runtime.clock.sleep(0)
            apart = [abs(now() - runtime.clock.now()) / 1e9 for now in (read, session.now, runtime.clock.reader())]
            return fired, max(apart) < 1, late.now() < session.now() - HOUR * 10**9

    assert run(main) == ([True], True, True)


def test_where_the_time_is_set_and_nothing_was_suspended_nothing_leaps(suspension):
    async def main():
        async with Runtime(log=None) as runtime:
            faults = probe(runtime.faults)
            before, asked = runtime.clock.now(), suspension.asked
            suspension.end(runtime.clock, 0.0)
            while suspension.asked == asked:
                await runtime.clock.sleep(0.01)
            return list(faults), runtime.clock.now() - before < HOUR * 1e9

    assert run(main) == ([], True)
