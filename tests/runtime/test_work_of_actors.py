"""The workload of an actor: what its end, or its failure, means for both."""

from __future__ import annotations

import asyncio

import pytest

from mdm import Actor, Runtime, VirtualClock, run
from mdm.testing import run_virtual


def test_work_that_ignores_its_end_is_abandoned_and_reported():
    async def stubborn(free):
        while not free.is_set():
            try:
                await free.wait()
            except asyncio.CancelledError:
                continue

    async def main():
        free = asyncio.Event()
        faults = []
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            runtime.faults.subscribe(faults.append)
            actor = Actor("actor", grace=2)
            await runtime.start(actor)
            actor.spawn(stubborn(free), name="stubborn")
        assert [(fault.kind, fault.source) for fault in faults] == [("abandoned", "actor")]
        assert "stubborn did not end within 2 s" in faults[0].detail
        assert len(runtime.abandoned) == 1
        free.set()
        await asyncio.sleep(0.1)
        assert runtime.abandoned == []  # it has ended after all

    run(main, virtual=True)


def test_who_waits_for_what_was_abandoned_misses_nothing():
    async def stubborn(seconds):
        try:
            await asyncio.sleep(1e6)
        except asyncio.CancelledError:
            await asyncio.sleep(seconds)

    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            actor = Actor("actor", grace=1)
            await runtime.start(actor)
            works = [actor.spawn(stubborn(seconds)) for seconds in (5, 7, 6)]
            await asyncio.sleep(0)
        assert runtime.abandoned == works
        for work in runtime.abandoned:
            await asyncio.wait([work.task])
        assert [work.done for work in works] == [True] * 3
        assert runtime.abandoned == []

    run(main, virtual=True)


def test_an_error_in_work_or_a_timer_is_the_actor_s_failure():
    async def broken():
        raise ValueError("in work")

    for disturb in (
        lambda actor: actor.spawn(broken()),
        lambda actor: actor.call_later(1, lambda: 1 / 0),
        lambda actor: actor.every(10, lambda tick: 1 / 0),
    ):

        async def main(runtime, disturb=disturb):
            actor = Actor("actor", supervision="stop")
            await runtime.start(actor)
            disturb(actor)
            await asyncio.sleep(2)
            return actor.life

        assert run_virtual(main) == "failed"


class Panic(BaseException):
    """What native code may raise."""


async def awaits_what_was_cancelled():
    future = asyncio.get_running_loop().create_future()
    future.cancel()
    await future


async def panics():
    raise Panic("in the driver")


@pytest.mark.parametrize("work", [awaits_what_was_cancelled, panics])
def test_work_that_nobody_cancelled_and_that_ends_so_is_a_failure(work):
    async def main(runtime):
        actor, faults = Actor("actor", supervision="stop"), []
        await runtime.start(actor)
        runtime.faults.subscribe(faults.append)
        actor.spawn(work())
        await asyncio.sleep(1)
        assert actor.life == "failed"
        assert ["cancelled" in fault.detail or "Panic" in fault.detail for fault in faults] == [True]

    run_virtual(main)
