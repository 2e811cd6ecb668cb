"""Work: how it ends with its actor, and what is done where it does not."""

from __future__ import annotations

import asyncio
import inspect
import sys
from contextlib import suppress

import pytest

from mdm import Actor
from mdm.testing import run_virtual


def test_work_ends_with_its_actor_and_may_await_while_it_cleans_up():
    log = []

    class Worker(Actor):
        def on_start(self):
            self.spawn(self.work(), lambda work: log.append(("ended", work.cancelled)))

        async def work(self):
            try:
                await asyncio.sleep(3600)
            finally:
                await asyncio.sleep(0.5)
                await asyncio.sleep(0.5)
                log.append("clean")

    async def main(runtime):
        await runtime.start(Worker("worker"))
        await asyncio.sleep(1)

    run_virtual(main)
    assert log == ["clean", ("ended", True)]


def test_work_that_its_actor_cancels_is_no_failure_even_before_it_has_begun():
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        actor.spawn(asyncio.sleep(100)).cancel()
        actor.spawn(asyncio.sleep(100))
        await asyncio.sleep(1)
        assert actor.life == "running"

    run_virtual(main)


def test_a_task_or_future_that_was_handed_in_ends_with_the_work_even_before_that_has_begun():
    async def lingers():
        try:
            await asyncio.sleep(100)
        finally:
            await asyncio.sleep(1)

    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        task, future = asyncio.create_task(lingers()), asyncio.get_running_loop().create_future()
        await asyncio.sleep(0)
        ended = []
        pieces = [actor.spawn(awaitable, ended.append) for awaitable in (task, future)]
        for work in pieces:
            work.cancel()
        await asyncio.sleep(0.5)
        assert ended == [pieces[1]]
        await asyncio.sleep(1)
        assert ended == pieces[::-1]
        assert [(work.interrupted, work.cancelled) for work in pieces] == [(True, True)] * 2
        assert task.cancelled()
        assert future.cancelled()

    run_virtual(main)


@pytest.mark.parametrize("room", range(1, 30))
def test_a_cancellation_that_a_deep_stack_cuts_short_can_be_asked_for_again(room):
    def deep(levels, function):
        if levels:
            deep(levels - 1, function)
        else:
            function()

    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        piece = actor.spawn(asyncio.sleep(3600), lambda _: None)
        await asyncio.sleep(1)
        with suppress(RecursionError):
            deep(sys.getrecursionlimit() - len(inspect.stack()) - room, piece.cancel)
        piece.cancel()
        await asyncio.sleep(1)
        return piece.done

    limit = sys.getrecursionlimit()
    assert run_virtual(main)
    assert sys.getrecursionlimit() == limit
