"""Clocks, virtual time and ticks."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import threading
import time
from fractions import Fraction

import anyio
import pytest
from hypothesis import given, strategies as st

from mdm import Actor, DeadlockError, Error, Runtime, VirtualClock, WallClock, run
from mdm.runtime import Clock, Latencies, Ticker
from mdm.testing import run_virtual


@pytest.mark.parametrize("rate", [0.1, 1, 3, 7, 10, 29.97, 30, 60, 100, 333.3])
def test_ticks_do_not_drift(rate):
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        ticks = []
        actor.every(rate, ticks.append)
        await asyncio.sleep(min(3600, 20_000 / rate))
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


def test_every_kind_of_sleep_obeys_virtual_time():
    async def main(runtime):
        began = time.monotonic()
        await asyncio.sleep(1000)
        await anyio.sleep(1000)
        await runtime.clock.sleep(1000)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(500):
                await asyncio.Event().wait()
        with anyio.move_on_after(500):
            await anyio.sleep_forever()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.Event().wait(), 1000)
        assert time.monotonic() - began < 5
        return runtime.clock.time()

    assert run_virtual(main) == pytest.approx(5000)


def test_a_deadlock_is_found():
    async def main(runtime):
        await asyncio.Event().wait()

    with pytest.raises(DeadlockError, match="virtual time stands still"):
        run_virtual(main)


def test_threads_may_still_bring_input_in_virtual_time():
    async def main(runtime):
        return await asyncio.get_running_loop().run_in_executor(None, lambda: 7)

    assert run_virtual(main) == 7


def test_a_virtual_clock_needs_a_virtual_loop():
    async def main():
        async with Runtime(clock=VirtualClock(), log=None):
            pass

    with pytest.raises(Error, match=r"mdm\.run\(main, virtual=True\)"):
        run(main)


def test_input_of_an_instant_comes_before_its_tick():
    order = []

    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        actor.every(1, lambda tick: order.append(("tick", tick.number)))

        async def sensor():
            for number in range(1, 4):
                await asyncio.sleep(1)
                order.append(("sensor", number))

        actor.spawn(sensor())
        actor.call_at(2_000_000_000, lambda: order.append(("timer", 2)))
        await asyncio.sleep(3.5)

    run_virtual(main)
    assert order == [
        ("tick", 0),
        ("sensor", 1),
        ("tick", 1),
        *sorted([("timer", 2), ("sensor", 2)], reverse=True),
        ("tick", 2),
        ("sensor", 3),
        ("tick", 3),
    ]


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
        clock = WallClock()
        assert abs(clock.now() - time.time_ns()) < 1_000_000_000
        async with Runtime(clock=clock, log=None):
            with pytest.raises(RuntimeError, match="already serves a runtime"):
                async with Runtime(clock=clock, log=None):
                    pass

    run(main)


@given(st.lists(st.integers(1, 10**10), min_size=1, max_size=200))
def test_latencies_are_exact_to_an_eighth_of_an_octave(values):
    latencies = Latencies()
    for value in values:
        latencies.record(value)
    histogram = latencies.snapshot()
    assert histogram.count == len(values)
    assert histogram.total == pytest.approx(sum(values) / 1e9)
    assert histogram.maximum == max(values) / 1e9
    for fraction in (0.1, 0.5, 0.9, 1.0):
        rank = max(1, -(-fraction * len(values) // 1))
        exact = sorted(values)[int(rank) - 1] / 1e9
        assert exact <= histogram.quantile(fraction) * (1 + 1e-9) <= exact * 1.2 + 2e-9


PROGRAM = """
import asyncio, sys, mdm
from mdm.messages import State

class Robot(mdm.Actor):
    def on_start(self):
        self.spawn(self.drive(), lambda work: print("work ended", flush=True))
    async def drive(self):
        try:
            print("ready", flush=True)
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(0.01)
            print("motors off", flush=True)
    def on_stop(self):
        print("stopped", flush=True)

async def main():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(Robot("robot"))
        await runtime.wait()

mdm.run(main, uvloop=len(sys.argv) > 1)
"""


@pytest.mark.parametrize("loop", [[], ["uvloop"]])
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)])
def test_signals_stop_a_program_in_order(loop, number, status):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *loop],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    output, errors = process.communicate(timeout=20)
    assert output == "motors off\nwork ended\nstopped\n"
    assert process.returncode in {status, 130}, errors


def test_run_works_in_another_thread():
    results = []

    async def main():
        async with Runtime(log=None):
            results.append("ran")

    thread = threading.Thread(target=lambda: run(main))
    thread.start()
    thread.join()
    assert results == ["ran"]
