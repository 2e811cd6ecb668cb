"""The watchdog: real threads and a real clock, for it is what is there when the event loop is not."""

from __future__ import annotations

import asyncio
import re
import signal
import threading
import time
from itertools import pairwise

import pytest
from patience import PATIENCE
from programs import python

from mdm import Ensemble, Error, FixedRate, Runtime, run
from mdm.policies import DeterministicPolicy
from mdm.runtime.process.watchdog import Watchdog
from mdm.testing import probe, run_virtual


class Lines:
    """A logger that keeps its faults, and when they came."""

    def __init__(self):
        self.faults = []

    def error(self, _, **fields):
        self.faults.append((time.monotonic(), fields))

    def info(self, *_, **__):
        pass

    debug = warning = info


def hold_asleep(is_enough):
    while not is_enough():
        time.sleep(0.05)


def hold_busily(is_enough):
    while not is_enough():
        pass


def enough(told, count, seconds):
    """Return a function that says whether so many are told and so many seconds over; a minute is always enough."""
    begun = time.monotonic()
    return lambda: begun + (seconds if len(told) >= count else 60) <= time.monotonic()


def robot(hold, told):
    calls, ended = [], []

    def grab():
        calls.append(time.monotonic())
        if len(calls) == 3:
            hold(enough(told, len(told) + 1, 1.1))
            ended.append(time.monotonic())

    made = Ensemble("robot", policy=DeterministicPolicy([0], 1), actions={"grab": grab}, drive=FixedRate(20.0))
    return made, calls, ended


def kinds(faults):
    return [fault.kind for fault in faults]


def ours():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("mdm:")]


def told_of(hold, detail):
    return f"in {hold.__name__}" in detail


@pytest.mark.parametrize("hold", [hold_asleep, pytest.param(hold_busily, marks=pytest.mark.slow)])
@pytest.mark.parametrize("uvloop", [False, True])
def test_a_loop_that_is_held_is_reported_in_time_with_what_holds_it(hold, uvloop):
    if uvloop:
        pytest.importorskip("uvloop")
    lines = Lines()

    async def main():
        made, calls, ended = robot(hold, lines.faults)
        async with Runtime(log=lines, watchdog=0.3) as runtime:
            faults = probe(runtime.faults)
            await runtime.start(made)
            made.publish_state(0)
            while len(calls) < 5 or not any(told_of(hold, fault.detail) for fault in faults[:-1]):
                await asyncio.sleep(0.01)
            return calls[2], ended[0], faults, runtime.statistics(), made.control.statistics()

    begun, ended, faults, statistics, control = run(main, uvloop=uvloop)
    held = ended - begun
    assert {fault.kind for fault in faults} == {"stall"}
    assert [fault.detail for fault in faults] == [fault["detail"] for _, fault in lines.faults]
    # A busy machine may hold the loop by itself besides.
    place = next(at for at, fault in enumerate(faults) if told_of(hold, fault.detail))
    (told, first), (_, second) = lines.faults[place : place + 2]
    assert begun + 0.299 <= told < ended  # before the loop turned again
    assert "the event loop has not turned for 0.3 s: it is held at" in first["detail"]
    assert f"in {hold.__name__}" in first["detail"]
    assert "in grab (hold(enough(told, len(told) + 1, 1.1)))" in first["detail"]
    assert first["detail"].index(hold.__name__) < first["detail"].index("in grab")
    assert "run_forever" not in first["detail"] or uvloop
    assert "the event loop stood still for " in second["detail"]
    assert statistics.loop.stalls == sum("stood still" in fault.detail for fault in faults)
    assert ended - told + 0.299 < statistics.loop.delays.maximum  # from when the loop was asked, as for what was told
    assert control.missed >= 20 * held - 5
    assert held - 0.25 < control.latency.maximum


def test_a_loop_that_turns_is_left_in_peace_and_no_thread_is_left():
    lines = Lines()

    async def main():
        async with Runtime(log=lines, watchdog=0.5) as runtime:
            turns = [time.monotonic()]
            while runtime.statistics().loop.delays.count < 10:
                await asyncio.sleep(0.01)
                turns.append(time.monotonic())
            names = ours()
        return names, runtime.statistics().loop, [after - before for before, after in pairwise(turns)]

    names, found, turns = run(main)
    assert sorted(names) == ["mdm:log", "mdm:watchdog"]
    assert ours() == []
    slow = sum(each > 0.4 for each in turns)  # a busy machine may hold the loop by itself
    assert found.stalls <= slow
    assert len(lines.faults) <= 2 * slow


def test_no_watchdog_where_none_is_wanted_or_time_is_virtual():
    async def main():
        async with Runtime(log=None, watchdog=None) as runtime:
            return ours(), runtime.statistics().loop

    assert run(main) == ([], None)

    async def watched(runtime):
        return ours(), runtime.statistics().loop

    assert run_virtual(watched, log=Lines()) == ([], None)


def test_the_emergency_is_called_in_time_once_each_stall_and_its_failure_is_told():
    lines, called = Lines(), []

    def emergency():
        called.append((time.monotonic(), threading.current_thread().name))
        raise SystemExit("no relay")

    async def main():
        async with Runtime(log=lines, watchdog=0.3, emergency=emergency, emergency_after=1.0) as runtime:
            faults, held = probe(runtime.faults), []
            for count in (1, 2):
                begun = time.monotonic()
                hold_asleep(enough(called, count, 1.4))
                held.append((begun, time.monotonic()))
                while kinds(faults).count("emergency") < 2 * count or faults[-1].kind != "stall":
                    await asyncio.sleep(0.01)
            before = len(faults)
            hold_asleep(enough(lines.faults, before + 1, 0.4))  # long enough to be told
            while len(faults) < before + 2:
                await asyncio.sleep(0.01)
            return held, faults

    held, faults = run(main)
    assert [name for _, name in called] == ["mdm:emergency"] * 2
    for (begun, ended), (when, _) in zip(held, called, strict=True):
        assert begun + 0.999 <= when < ended
    each, more = "stall emergency emergency stall ", "(stall stall )"  # a busy machine may hold the loop by itself
    assert re.fullmatch(f"{more}*{each}{more}*{each}{more}+", " ".join([*kinds(faults), ""]))
    first, second, *_ = [fault for fault in faults if fault.kind == "emergency"]
    assert first.source == "runtime"
    assert first.detail == "the event loop has not turned for 1 s"
    assert second.detail.startswith("`emergency` failed: SystemExit: no relay (at ")
    assert len(lines.faults) == len(faults)
    assert ours() == []


def test_an_emergency_that_does_not_end_does_not_end_the_watch():
    hold, called = threading.Event(), []

    def emergency():
        called.append(None)
        hold.wait(PATIENCE)

    async def main():
        async with Runtime(log=None, watchdog=0.5, emergency=emergency) as runtime:
            faults = probe(runtime.faults)
            for held in (1, 2):
                hold_asleep(enough(called, held, 1.5))
                while kinds(faults).count("stall") < 2 * held:
                    await asyncio.sleep(0.01)
        return kinds(faults)

    try:
        told = run(main)
        # A busy machine holds the loop by itself, too, which is a stall more and no emergency.
        rounds = " ".join(told).split("emergency")
        assert [len(stalls.split()) >= 2 for stalls in rounds] == [False, True, True]
        assert {*told} == {"emergency", "stall"}
        assert len(called) == 2
    finally:
        hold.set()


@pytest.mark.slow
def test_native_calls_that_hold_the_interpreter_one_after_the_other_are_reported():
    lines, called = Lines(), []

    async def main():
        async with Runtime(log=lines, watchdog=0.1, emergency=lambda: called.append(time.monotonic())) as runtime:
            while not runtime.statistics().loop.delays.count:
                await asyncio.sleep(0.01)
            number = 1_000_000
            while True:  # as many as keep it for twice the limit, be the machine slow or fast
                begun = time.monotonic()
                sum(range(number))
                if time.monotonic() - begun > 0.2:
                    break
                number *= 2
            await asyncio.sleep(0.5)
            told = len(lines.faults)
            is_enough = enough(lines.faults, told + 2, 0.0)
            while not is_enough():
                sum(range(number))
            ended = time.monotonic()
            await asyncio.sleep(0.1)
            return told, ended

    told, ended = run(main)
    assert called
    assert called[-1] < ended
    assert "the event loop has not turned for 0.1 s: it is held at" in lines.faults[told + 1][1]["detail"]
    assert lines.faults[told + 1][0] < ended


def test_a_watchdog_whose_alarm_fails_goes_on():
    told = []

    def alarm(kind, detail):
        told.append((kind, detail))
        if len(told) == 1:
            raise MemoryError

    async def main():
        watchdog = Watchdog(0.5, alarm, print, None)
        watchdog.open(asyncio.get_running_loop())
        for number in (2, 4):
            hold_asleep(enough(told, number - 1, 1.5))
            while len(told) < number:
                await asyncio.sleep(0.01)
        watchdog.close()
        return watchdog.statistics().stalls

    assert run(main) == 2
    assert ours() == []


STOPPED = """
import asyncio, os, mdm

async def main():
    async with mdm.Runtime(log=None, watchdog=2.0, emergency=lambda: os.write(1, b"emergency\\n")) as runtime:
        ended = asyncio.Event()
        runtime.faults.subscribe(lambda fault: ended.set() if "stood still" in fault.detail else None)
        os.write(1, b"running\\n")
        await ended.wait()

mdm.run(main)
os.write(1, b"told\\n")
"""


def test_a_process_that_was_stopped_is_no_emergency():
    with python("-c", STOPPED) as process:
        assert process.stdout.readline() == "running\n"
        process.send_signal(signal.SIGSTOP)
        time.sleep(3.0)  # what is tried: that long it stands still
        process.send_signal(signal.SIGCONT)
        assert process.stdout.readline() == "told\n"
        assert process.wait(PATIENCE) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"watchdog": 0}, "watchdog is a number of seconds above 0"),
        ({"watchdog": 0.001}, r"a watchdog waits 0.01 s at least, not 0.001"),
        ({"emergency": 7}, "`emergency` is a function, not 7"),
        ({"emergency": asyncio.sleep}, "`emergency` must be a plain function"),
        ({"emergency": lambda reason: reason}, "`emergency` is called without arguments: missing .* 'reason'"),
        ({"emergency_after": 2.0}, "emergency_after is the time until the watchdog calls `emergency`: give both"),
        ({"emergency": list, "emergency_after": 2.0, "watchdog": None}, "give both"),
        ({"emergency": list, "emergency_after": 0.5}, r"emergency_after is 0.5 s, before the watchdog's 1.0 s"),
    ],
)
def test_what_cannot_be_watched_is_refused(options, words):
    with pytest.raises(Error, match=words):
        Runtime(log=None, **options)
