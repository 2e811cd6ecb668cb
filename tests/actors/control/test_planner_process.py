"""A process that searches: its answers, newer questions, and its end."""

from __future__ import annotations

import asyncio
import os

import numpy as np
import pytest

from mdm.actors.control.planner import SearchProcess
from mdm.problems import tiger
from mdm.solvers import TreeSearch

HALF = np.array([0, 1]), np.array([0.5, 0.5])
SURE = np.array([1]), np.array([1.0])


@pytest.fixture(autouse=True)
def _patience(monkeypatch):
    """Let a busy machine take its time to end a process of low priority."""
    monkeypatch.setattr("mdm.actors.control.planner._LAST_WORDS", 60.0)


def run(main, **options):
    """Run a coroutine function with a process that has started; return its status at the end, too."""

    async def program():
        process = SearchProcess(TreeSearch(tiger(), **options))
        await process.start()
        try:
            result = await main(process)
        finally:
            status = await process.end()
        return result, status

    async def in_time():
        async with asyncio.timeout(120):
            return await program()

    return asyncio.run(in_time())


def test_it_answers_what_the_search_finds():
    async def main(process):
        process.ask(1, *HALF)
        first = await process.answer()
        process.ask(2, *SURE)
        return first, await process.answer(), process.pid

    (first, second, pid), status = run(main, expansions=300, seed=4)
    search = TreeSearch(tiger(), expansions=300, seed=4)
    assert first[0] == 1
    assert first[1].action == search.action([0.5, 0.5])
    assert (second[0], second[1].action) == (2, search.action([0.0, 1.0]))
    assert status == 0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_newer_question_ends_the_search_for_the_older():
    async def main(process):
        process.ask(1, *HALF)
        process.ask(2, *SURE)
        number, _ = await process.answer()
        process.ask(3, *SURE)
        return number, (await process.answer())[0]

    (first, second), _ = run(main, seconds=3600.0)
    assert (first, second) == (1, 2)


def test_what_was_never_started_has_no_end():
    process = SearchProcess(TreeSearch(tiger(), expansions=1))
    assert process.pid is None
    assert asyncio.run(process.end()) is None


def test_a_process_that_ends_by_itself_is_noticed():
    async def main(process):
        os.kill(process.pid, 9)
        with pytest.raises(EOFError):
            await process.answer()

    _, status = run(main, expansions=1)
    assert status == -9
