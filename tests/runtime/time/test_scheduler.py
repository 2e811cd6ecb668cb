"""Ticks: aligned, without drift, and what is done about those that come late."""

from __future__ import annotations

import asyncio
import time
from fractions import Fraction

import pytest
from sentences import refused

from mdm import Actor, ConfigError, Runtime, run
from mdm.runtime import Clock, Ticker
from mdm.testing import run_virtual


@pytest.mark.parametrize("rate", [0.1, 1, 3, 7, 10, 29.97, 30, 60, 100, 333.3])
def test_ticks_do_not_drift(rate):
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        ticks = []
        actor.every(rate, ticks.append)
        await asyncio.sleep(min(3600, 5_000 / rate))
        return ticks

    ticks = run_virtual(main)
    exact = Fraction(rate).limit_denominator(1_000_000)
    assert all(tick.late == 0 and tick.missed == 0 for tick in ticks)
    assert [tick.number for tick in ticks] == list(range(len(ticks)))
    for tick in (ticks[0], ticks[len(ticks) // 2], ticks[-1]):
        assert 0 <= tick.time - tick.number * 1_000_000_000 / exact < 1


def test_ticks_are_aligned_whenever_they_begin():
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        await asyncio.sleep(0.123)
        first, second = [], []
        actor.every(4, first.append)
        await asyncio.sleep(0.3)
        actor.every(4, second.append)
        await asyncio.sleep(1)
        return [tick.time for tick in first], [tick.time for tick in second]

    first, second = run_virtual(main)
    assert first[:3] == [250_000_000, 500_000_000, 750_000_000]
    assert set(second) <= set(first)


@pytest.mark.parametrize(("overrun", "expected"), [("skip", [0, 3, 4]), ("burst", [0, 1, 2, 3, 4])])
def test_overruns_are_skipped_and_counted_or_made_up_for(overrun, expected):
    class Manual(Clock):
        shown = 0

        def now(self):
            return self.shown

        def _arm(self, when):
            pass

        def show(self, seconds):
            self.shown = round(seconds * 1e9)
            for _ in range(10):
                self._fire_due()

    clock, ticks = Manual(), []
    ticker = Ticker(clock, 1, ticks.append, overrun=overrun)
    clock.show(0.5)
    clock.show(3.1)  # something has blocked the loop
    clock.show(4)
    assert [tick.number for tick in ticks] == expected
    assert (ticker.missed, ticker.ticks) == (2 if overrun == "skip" else 0, len(expected))
    assert [tick.late for tick in ticks][-2:] == [100_000_000, 0]


def test_ticks_that_a_held_loop_skipped_are_in_the_statistics():
    async def main():
        async with Runtime(log=None) as runtime:
            actor, late = Actor("actor"), []
            await runtime.start(actor)
            ticker = actor.every(1000, late.append)
            time.sleep(0.02)  # noqa: ASYNC251 - holds the loop
            while not ticker.missed:
                await asyncio.sleep(0.001)
            counted = actor.statistics().skipped_ticks
            assert counted == ticker.missed
            await runtime.stop(actor)
            assert actor.statistics().skipped_ticks >= counted > 0

    run(main)


def test_a_word_that_is_no_treatment_of_overruns_is_refused():
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        with refused(ConfigError):
            actor.every(1, str, overrun="drop")

    run_virtual(main)
