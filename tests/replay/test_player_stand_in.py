"""Stand-ins of functions: they last until they are told to end, whatever is asked of them."""

from __future__ import annotations

import asyncio

import pytest

from mdm.replay.player import AsRecordedError, StandIn
from mdm.runtime.work import Work


async def _wait(stand_in):
    await stand_in


async def _rounds(count=5):
    for _ in range(count):
        await asyncio.sleep(0)


@pytest.mark.parametrize("error", [None, AsRecordedError("ValueError: as it was"), asyncio.CancelledError()])
def test_it_ends_as_it_is_told(error):
    async def main():
        stand_in = StandIn()
        task = asyncio.ensure_future(_wait(stand_in))
        await _rounds()
        assert not task.done()
        stand_in.end(error)
        if error is None:
            await task
        else:
            with pytest.raises(type(error)):
                await task

    asyncio.run(main())


def test_a_cancellation_does_not_end_it():
    async def main():
        stand_in = StandIn()
        task = asyncio.ensure_future(_wait(stand_in))
        await _rounds()
        task.cancel()
        await _rounds()
        assert not task.done()
        stand_in.end()
        await task

    asyncio.run(main())


@pytest.mark.parametrize("rounds", [0, 5])
def test_one_that_is_released_lasts_until_it_is_cancelled(rounds):
    async def main():
        stand_in = StandIn()
        ended = []
        work = Work(stand_in, "action", ended.append)
        await _rounds(rounds)
        stand_in.release()
        await _rounds()
        assert not work.done
        work.cancel()
        await work.over
        assert (work.interrupted, work.error, ended) == (True, None, [work])

    asyncio.run(main())


def test_what_is_done_is_done_within_its_task():
    async def main():
        stand_in = StandIn()
        task = asyncio.ensure_future(_wait(stand_in))
        found = []
        await stand_in.do(lambda: found.append(asyncio.current_task()))
        assert found == [task]
        stand_in.end()
        await task

    asyncio.run(main())


def test_it_may_be_told_to_end_before_it_begins():
    async def main():
        stand_in = StandIn()
        stand_in.end()
        await stand_in

    asyncio.run(main())
