"""Executors: a piece of work has ended when its threads have."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
from patience import PATIENCE
from sentences import refused

from mdm import Actor, Runtime, run
from mdm.runtime.work import Jobs
from mdm.testing import probe, run_virtual


async def soon(condition):
    """Let the event loop turn until something is so; it fails after ten seconds."""
    async with asyncio.timeout(PATIENCE):
        while not condition():
            await asyncio.sleep(0.001)


@pytest.mark.parametrize("uvloop", [False, True])
@pytest.mark.parametrize("own", [False, True])
def test_cancelled_work_has_ended_when_its_thread_has(uvloop, own):
    if uvloop:
        pytest.importorskip("uvloop")

    async def main():
        pool = ThreadPoolExecutor() if own else None
        begun, free, ended = threading.Event(), threading.Event(), []

        def drive():
            begun.set()
            free.wait(PATIENCE)

        async def work():
            await asyncio.gather(asyncio.get_running_loop().run_in_executor(pool, drive))

        async with Runtime(log=None) as runtime:
            actor = Actor("actor")
            await runtime.start(actor)
            piece = actor.spawn(work(), ended.append)
            await soon(begun.is_set)
            piece.cancel()
            await soon(piece.task.done)
            assert (piece.done, ended) == (False, [])
            free.set()
            await soon(lambda: piece.done)
            assert ended == [piece]
            assert piece.cancelled
        if pool is not None:
            pool.shutdown()

    run(main, uvloop=uvloop)


def test_what_no_thread_has_begun_is_dropped():
    async def main():
        begun, free, ran = threading.Event(), threading.Event(), []
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(max_workers=1))

        def hold():
            begun.set()
            free.wait(PATIENCE)

        async with Runtime(log=None) as runtime:
            actor = Actor("actor")
            await runtime.start(actor)
            holding = asyncio.create_task(asyncio.to_thread(hold))
            await soon(begun.is_set)
            piece = actor.spawn(asyncio.to_thread(ran.append, 1))
            await asyncio.sleep(0)
            piece.cancel()
            await soon(lambda: piece.done)
            free.set()
            await holding
            await asyncio.to_thread(int)
        assert ran == []

    run(main)


class Short(ThreadPoolExecutor):
    """Has no thread for what is handed in now and then, and has queued it all the same, as Python's own."""

    def __init__(self):
        super().__init__(max_workers=1)
        self.short = False

    def _adjust_thread_count(self):
        if self.short:
            raise RuntimeError("can't start new thread")
        super()._adjust_thread_count()


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("plain", [False, True])
def test_what_no_thread_was_had_for_fails_at_once_and_never_begins(own, plain):
    async def main():
        loop, pool, ran, begun, free = asyncio.get_running_loop(), Short(), [], threading.Event(), threading.Event()
        if not own:
            loop.set_default_executor(pool)

        def hold():
            begun.set()
            free.wait(PATIENCE)

        async def work():
            await loop.run_in_executor(pool if own else None, ran.append, 1)

        async with Runtime(log=None) as runtime:
            actor = Actor("actor")
            await runtime.start(actor)
            holding = loop.run_in_executor(pool, hold)
            await soon(begun.is_set)
            pool.short = True
            if plain:  # such as an action that is a plain function
                jobs = Jobs()
                with refused(RuntimeError):
                    jobs.call(loop.run_in_executor, pool if own else None, ran.append, 1)
                assert jobs.count == 0
            else:
                piece = actor.spawn(work(), lambda _: None)
                await soon(piece.task.done)
                assert piece.done
                assert isinstance(piece.error, RuntimeError)
            pool.short = False
            free.set()
            await holding
            await loop.run_in_executor(pool, int)
        pool.shutdown()
        assert ran == []

    run(main)


@pytest.mark.parametrize("own", [False, True])
def test_an_executor_that_was_shut_down_is_an_error_of_the_work(own):
    async def main():
        loop, pool = asyncio.get_running_loop(), ThreadPoolExecutor()
        loop.set_default_executor(pool)
        pool.shutdown()
        async with Runtime(log=None) as runtime:
            actor = Actor("actor")
            await runtime.start(actor)

            async def work():
                await loop.run_in_executor(pool if own else None, int)

            piece = actor.spawn(work(), lambda _: None)
            await soon(piece.task.done)
            assert piece.done
            assert "after shutdown" in str(piece.error)

    run(main)


def test_a_process_pool_that_was_shut_down_is_an_error_of_the_work():
    async def main():
        pool = ProcessPoolExecutor(max_workers=1)
        pool.shutdown()
        jobs = Jobs()
        async with Runtime(log=None):
            with refused(RuntimeError):
                jobs.call(asyncio.get_running_loop().run_in_executor, pool, abs, -7)
            assert jobs.count == 0

    run(main)


def test_a_process_pool_works_as_before():
    async def main():
        with ProcessPoolExecutor(max_workers=1) as pool:
            async with Runtime(log=None) as runtime:
                actor = Actor("actor")
                await runtime.start(actor)
                piece = actor.spawn(asyncio.get_running_loop().run_in_executor(pool, abs, -7), lambda _: None)
                await soon(lambda: piece.done)
                return piece.result

    assert run(main) == 7


def test_a_thread_beyond_its_grace_is_abandoned_and_listed():
    free = threading.Event()

    async def main(runtime):
        actor = Actor("actor", grace=2.0)
        faults = probe(runtime.faults)
        await runtime.start(actor)
        piece = actor.spawn(asyncio.to_thread(free.wait, 10), name="drive")
        await asyncio.sleep(0)
        await runtime.stop(actor)
        assert runtime.abandoned == [piece]
        assert "drive did not end within 2 s" in faults[0].detail
        free.set()

    run_virtual(main)


def test_the_loop_gets_its_own_way_back():
    async def main():
        loop = asyncio.get_running_loop()
        async with Runtime(log=None):
            async with Runtime(log=None):
                pass
            assert "run_in_executor" in vars(loop)
        assert "run_in_executor" not in vars(loop)

    run(main)
