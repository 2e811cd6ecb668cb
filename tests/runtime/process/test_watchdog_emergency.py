"""The emergency: called beside the event loop, which it never holds."""

from __future__ import annotations

import asyncio
import threading

import pytest
from patience import PATIENCE
from sentences import refused

from mdm import Error, Runtime, run
from mdm.runtime.process.watchdog import Emergency
from mdm.testing import probe, run_virtual


def test_the_emergency_is_at_the_hand_of_other_code():
    called = []

    async def main(runtime):
        faults = probe(runtime.faults)
        runtime.emergency("the safe action failed twice")
        return [(fault.source, fault.kind, fault.detail) for fault in faults]

    expected = ("runtime", "emergency", "the safe action failed twice")
    assert run_virtual(main, emergency=lambda: called.append(None)) == [expected]
    assert called == [None]
    ((*_, detail),) = run_virtual(main)
    assert detail == "the safe action failed twice, and no `emergency` was given to Runtime"


def test_one_that_blocks_holds_nothing_and_is_told_of_first():
    free, begun, other = threading.Event(), threading.Event(), threading.Event()

    def block():
        begun.set()
        free.wait(PATIENCE)
        raise OSError("no relay")

    async def main():
        async with Runtime(log=None, emergency=block) as runtime:
            runtime.add_emergency(other.set)
            faults = probe(runtime.faults)
            runtime.emergency("the hand")
            assert [fault.detail for fault in faults] == ["the hand"]
            async with asyncio.timeout(PATIENCE):
                while not (begun.is_set() and other.is_set()):
                    await asyncio.sleep(0.001)
                free.set()
                while len(faults) < 2:
                    await asyncio.sleep(0.001)
            return faults[1].detail

    assert run(main).startswith("`emergency` failed: OSError: no relay (at ")
    assert not [thread for thread in threading.enumerate() if thread.name == "mdm:emergency"]


def test_one_that_is_under_way_at_the_end_gets_a_moment():
    free, ended = threading.Event(), []

    def cut():
        free.wait(PATIENCE)
        ended.append(None)

    async def main():
        async with Runtime(log=None, emergency=cut) as runtime:
            runtime.emergency("the hand")
            free.set()

    run(main)
    assert ended == [None]


@pytest.mark.parametrize("threads", [False, True])
def test_a_report_that_fails_keeps_no_emergency_from_being_called(threads, monkeypatch):
    called = []

    def report(_):
        raise MemoryError

    def start(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    emergency = Emergency(report, threads=threads)
    emergency.add(lambda: called.append(None))
    emergency.call("the hand")
    emergency.close()
    assert called == [None]


def test_emergencies_that_are_added_are_called_too_each_once():
    called = []

    def first():
        called.append("first")
        raise OSError("no relay")

    def second():
        called.append("second")

    async def main(runtime):
        faults = probe(runtime.faults)
        for _ in range(2):
            runtime.add_emergency(second)
        runtime.emergency("the hand")
        await asyncio.sleep(0)
        with refused(Error):
            runtime.add_emergency(asyncio.sleep)
        return [fault.detail for fault in faults]

    why, failed = run_virtual(main, emergency=first)
    assert why == "the hand"
    assert failed.startswith("`emergency` failed: OSError: no relay")
    assert called == ["first", "second"]
