"""Virtual time: sleeps, deadlocks, threads, and the order within an instant."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

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


async def rest(rounds):
    for _ in range(rounds):
        await asyncio.sleep(0)


async def time_out(rounds):
    with suppress(TimeoutError):
        await asyncio.wait_for(asyncio.Event().wait(), 1e-9)
    await rest(rounds)


@pytest.mark.parametrize("take", [rest, time_out])
@pytest.mark.parametrize("rounds", [0, 5, 50])
def test_a_tick_comes_behind_all_that_tasks_do_at_its_instant_in_however_many_rounds(take, rounds):
    """How many `asyncio.wait_for` takes depends on the version of Python."""
    order = []

    async def main(runtime):
        actors = [Actor("one"), Actor("other")]
        for actor in actors:
            await runtime.start(actor)
            actor.every(1, lambda tick, actor=actor: order.append((actor.name, tick.time)))
        await runtime.clock.sleep(1 - 1e-9 * (take is time_out))
        await take(rounds)
        order.append(("task", runtime.now()))
        await asyncio.sleep(0.5)

    run_virtual(main)
    second = 1_000_000_000
    assert order == [("one", 0), ("other", 0), ("task", second), ("one", second), ("other", second)]


def test_ticks_of_two_runtimes_wait_for_the_tasks_of_both():
    order = []

    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as one, Runtime(clock=VirtualClock(), log=None) as other:
            for runtime in (one, other):
                actor = Actor("actor")
                await runtime.start(actor)
                actor.every(1, lambda tick: order.append(tick.number))
            await asyncio.sleep(1)
            await rest(20)
            order.append("task")
            await asyncio.sleep(0.5)

    run(main, virtual=True)
    assert order == [0, 0, "task", 1, 1]


def test_a_task_that_never_rests_does_not_hold_ticks_for_ever():
    ticks = []

    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        actor.every(1, ticks.append)
        await asyncio.sleep(1)
        while len(ticks) < 2:
            await asyncio.sleep(0)
        return runtime.clock.time()

    assert run_virtual(main) == 1
