"""The start of an actor: what it raises, and what becomes of it when nobody waits for it any more."""

from __future__ import annotations

import asyncio

import pytest
from recorded import Recorded
from sentences import refused

from mdm import Actor, Ensemble
from mdm.testing import probe, run_virtual


def test_what_a_start_raises_is_raised_to_the_starter_and_stops_those_before():
    log = []

    class Broken(Actor):
        def on_start(self):
            raise LookupError("no device")

    async def main(runtime):
        parent = Recorded("parent", log)
        parent.add(Recorded("first", log))
        parent.add(Broken("second"))
        with refused(LookupError):
            await runtime.start(parent)
        assert runtime.root.children == ()
        await runtime.start(Recorded("other", log))

    run_virtual(main)
    assert [entry for entry in log if "parent" in entry[1]] == [
        ("start", "parent"),
        ("start", "parent/first"),
        ("stop", "parent/first"),
        ("stop", "parent"),
    ]


def test_a_cancelled_start_ends_what_has_started_in_good_order():
    log = []

    class Slow(Recorded):
        async def on_stopping(self):
            await asyncio.sleep(0.5)
            log.append(("stopping", self.path))

    async def main(runtime):
        parent = Slow("parent", log)
        parent.add(Recorded("child", log))
        starting = asyncio.create_task(runtime.start(parent))
        while parent.life == "created":
            await asyncio.sleep(0)
        starting.cancel()
        await asyncio.wait([starting])
        assert starting.cancelled()
        assert runtime.root.children == ()

    run_virtual(main)
    assert log[0] == ("start", "parent")
    assert log[-2:] == [("stopping", "parent"), ("stop", "parent")] or log[-3] == ("stopping", "parent")
    assert sum(what == "start" for what, _ in log) == sum(what == "stop" for what, _ in log)


@pytest.mark.parametrize("turns", range(0, 30, 2))
def test_a_start_that_is_cancelled_at_any_point_leaves_nothing(turns):
    """After so many turns of the event loop: in an actor's start, between two, or behind the last."""
    log = []

    async def main(runtime):
        parent = Recorded("parent", log)
        parent.add(Recorded("child", log))
        robot = Ensemble("robot", policy=[0], actions={"Go": lambda: None}, safe_action=lambda: None)

        async def start():
            for actor in (Recorded("first", log), parent, robot):
                await runtime.start(actor)

        starting = asyncio.create_task(start())
        for _ in range(turns):
            await asyncio.sleep(0)
        starting.cancel()
        await asyncio.wait([starting])
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        assert tasks == set()
        assert all(actor.life == "running" for actor in runtime.root.children)

    run_virtual(main)
    assert sorted(path for what, path in log if what == "start") == sorted(path for what, path in log if what == "stop")


@pytest.mark.parametrize("cancelled", [0.5, 1.0])
def test_what_a_start_raises_to_nobody_is_reported(cancelled):
    class Broken(Actor):
        def on_start(self):
            raise LookupError("no device")

        async def on_stopping(self):
            await asyncio.sleep(1.0)

    async def main(runtime):
        faults = probe(runtime.faults)
        starting = asyncio.create_task(runtime.start(Broken("broken")))
        asyncio.get_running_loop().call_later(cancelled, starting.cancel)
        await asyncio.wait([starting])
        await asyncio.sleep(2.0)
        return [fault.detail for fault in faults if "no device" in fault.detail], starting.cancelled()

    told, was_cancelled = run_virtual(main)
    assert len(told) == was_cancelled
    assert was_cancelled or cancelled == 1.0


def test_an_exit_that_a_start_raises_to_nobody_ends_the_runtime():
    class Leaving(Actor):
        def on_start(self):
            raise SystemExit("no device")

        async def on_stopping(self):
            await asyncio.sleep(1.0)

    async def main(runtime):
        starting = asyncio.create_task(runtime.start(Leaving("leaving")))
        await asyncio.sleep(0.5)
        starting.cancel()
        await asyncio.sleep(100)

    with refused(SystemExit):
        run_virtual(main)
