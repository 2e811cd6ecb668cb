"""Virtual time: sleeps, deadlocks, threads, and the order within an instant."""

from __future__ import annotations

import asyncio
import time

import anyio
import pytest
from sentences import refused

from mdm import Actor, DeadlockError, Error, Runtime, VirtualClock, run
from mdm.testing import run_virtual


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
        assert time.monotonic() - began < 500  # the shortest of these sleeps
        return runtime.clock.time()

    assert run_virtual(main) == pytest.approx(5000)


def test_a_deadlock_is_found():
    async def main(runtime):
        await asyncio.Event().wait()

    with refused(DeadlockError):
        run_virtual(main)


def test_threads_may_still_bring_input_in_virtual_time():
    async def main(runtime):
        return await asyncio.get_running_loop().run_in_executor(None, lambda: 7)

    assert run_virtual(main) == 7


def test_a_virtual_clock_needs_a_virtual_loop():
    async def main():
        async with Runtime(clock=VirtualClock(), log=None):
            pass

    with refused(Error):
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
