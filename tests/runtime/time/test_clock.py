"""The wall clock: never early, steady, and the time of day."""

from __future__ import annotations

import asyncio
import time

import pytest
from sentences import refused

from mdm import Actor, Runtime, VirtualClock, WallClock, run


@pytest.mark.parametrize("uvloop", [False, True])
def test_wall_timers_never_come_early(uvloop):
    if uvloop:
        pytest.importorskip("uvloop")

    async def main():
        async with Runtime(log=None) as runtime:
            actor = Actor("actor")
            await runtime.start(actor)
            late, done = [], asyncio.Event()

            def tick(tick):
                late.append(runtime.clock.now() - tick.time)
                if len(late) == 20:
                    done.set()

            actor.every(500, tick)
            await done.wait()
            return late

    assert min(run(main, uvloop=uvloop)) >= 0


def test_a_wall_clock_tells_the_time_of_day_and_serves_one_runtime():
    async def main():
        clock, before = WallClock(), time.time_ns()
        assert before - 1_000_000_000 < clock.now() < time.time_ns() + 1_000_000_000
        async with Runtime(clock=clock, log=None):
            with refused(RuntimeError):
                async with Runtime(clock=clock, log=None):
                    pass

    run(main)


@pytest.mark.parametrize("error", [ValueError, asyncio.CancelledError])
@pytest.mark.parametrize("virtual", [False, True])
def test_timers_behind_one_that_raises_are_fired_all_the_same(virtual, error):
    fired = []

    def broken():
        raise error

    async def main():
        async with Runtime(log=None) as runtime:
            asyncio.get_running_loop().set_exception_handler(lambda *_: None)
            when = runtime.clock.now() + 1_000_000
            runtime.clock.call_at(when, broken)
            for number in range(3):
                runtime.clock.call_at(when, lambda number=number: fired.append(number))
            await runtime.clock.sleep(0.05)

    run(main, virtual=virtual)
    assert fired == [0, 1, 2]


def test_a_clock_knows_by_how_much_the_time_of_day_was_put_right(monkeypatch):
    clock = WallClock()
    assert abs(clock.corrected()) < 1_000_000_000
    shown = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: shown() + 3_600_000_000_000)
    assert abs(clock.corrected() - 3_600_000_000_000) < 1_000_000_000
    assert VirtualClock().corrected() == 0


def test_a_clock_catches_up_with_a_time_of_day_that_is_ahead_and_never_goes_back(monkeypatch):
    clock, other, shown, hour = WallClock(), WallClock(), time.time_ns, 3_600_000_000_000
    read, ahead = clock.reader(), [hour]
    monkeypatch.setattr(time, "time_ns", lambda: shown() + ahead[0])
    for right in (hour, -hour):
        ahead[0] = right
        clock.catch_up()
        for now in (clock.now, read, other.now):  # that of a session, which serves no runtime, leaps too
            assert abs(now() - shown() - hour) < 1_000_000_000
