"""Ends, failures and cancellations in the middle of a start: nothing hangs, nothing untrue is told, all is latched."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial

import pytest
from safe_robots import Log, forever, robot

from mdm import Ensemble, Error, PredicateManager, Restart, Runtime, run
from mdm.messages import Control
from mdm.testing import crash, probe, run_virtual

STEPS = 45
"""More than the steps of the event loop that the start of three levels takes."""

HOW = ["cancel", "stop", "fail", "leave", "exit"]


def three_levels(log, supervision):
    """A hierarchy of three levels, each with a safe action, and an ensemble beside the middle one."""
    below = Ensemble("below", policy=[0], actions={"Work": forever}, safe_action=log.plain("BELOW"))
    beside = Ensemble("beside", policy=[0], actions={"Work": forever}, safe_action=log.plain("BESIDE"))
    middle = Ensemble("middle", policy=[0], actions={"Below": below}, safe_action=log.plain("MIDDLE"))
    actions = {"Middle": middle, "Beside": beside}
    return Ensemble("top", policy=[0, 1], actions=actions, safe_action=log.plain("TOP"), supervision=supervision)


def started(actor):
    """Return an actor and those below it that have begun to start, in that order."""
    found = [actor] if actor.life in {"starting", "running"} else []
    return found + [one for child in actor.children for one in started(child)]


async def break_off(how, runtime, top, start):
    match how:
        case "cancel":
            start.cancel()
        case "stop" if top.parent is not None:
            await runtime.stop(top)
        case "fail" if started(top):
            crash(started(top)[-1], Error("made to fail"))
        case "exit" if started(top):
            crash(started(top)[-1], SystemExit(3))


@pytest.mark.parametrize("supervision", ["escalate", "stop", Restart(backoff=0.5)], ids=["escalate", "stop", "restart"])
@pytest.mark.parametrize("how", HOW)
def test_an_end_at_any_step_of_a_start_takes_no_time_and_tells_nothing_untrue(how, supervision):
    async def main(steps):
        log, faults, start = Log(), [], None
        with suppress(Exception, SystemExit):
            async with Runtime(log=None) as runtime:
                faults, top = probe(runtime.faults), three_levels(log, supervision)
                start = asyncio.create_task(runtime.start(top))
                for _ in range(steps):
                    await asyncio.sleep(0)
                await break_off(how, runtime, top, start)
        await asyncio.wait([start])
        assert asyncio.get_running_loop().time() < 1.0
        told = [fault.detail for fault in faults if "made to fail" not in fault.detail]
        assert set(log) <= {"TOP"}  # which has begun to decide when all have started
        assert told == []

    for steps in range(STEPS):
        run(partial(main, steps), virtual=True)


@pytest.mark.parametrize("command", ["start", "stop", "reset", "release", "message"])
def test_what_is_asked_at_any_step_of_a_start_that_is_broken_off_raises_nothing_and_starts_nothing(command):
    async def main(runtime, steps, further):
        one, layers = robot(Log(), predicates=PredicateManager()), set()
        runtime.modes.subscribe(
            lambda told: told.mode != "stopped" and layers.update(each.life for each in one.children)
        )
        faults = probe(runtime.faults)
        start = asyncio.create_task(runtime.start(one))
        for _ in range(steps):
            await asyncio.sleep(0)
        start.cancel()
        for _ in range(further):
            await asyncio.sleep(0)
        if one.life in {"starting", "running"}:
            if command == "message":
                runtime.channel("robot/control", Control).publish(Control(runtime.clock.now(), "start"))
            elif one.life == "running" or command in {"start", "stop"}:
                getattr(one, command)()
        await asyncio.wait([start])
        assert (one.life, one.mode) != ("stopped", "deciding")
        assert layers <= {"running"}  # nothing but what runs changes its mode
        assert faults == []

    for steps in range(STEPS // 3):
        for further in range(STEPS // 3):
            run_virtual(partial(main, steps=steps, further=further))


@pytest.mark.parametrize("future", [False, True])
def test_a_start_broken_off_after_a_safe_action_that_has_failed_does_not_begin_it_again_before_its_layer_lives(future):
    called, ran = [], []

    def make_safe():
        called.append(len(ran))
        if future:
            pending = asyncio.get_running_loop().create_future()
            asyncio.get_running_loop().call_later(0.5, pending.set_exception, LookupError())
            return pending
        return work()

    async def work():
        ran.append(1)
        raise LookupError

    async def main(runtime, steps):
        faults = probe(runtime.faults)
        actions = {"Work": forever}
        one = Ensemble("one", policy=[0], actions=actions, safe_action=make_safe, predicates=PredicateManager())
        await runtime.start(one)
        one.publish_state(0)
        await runtime.stop(one)
        assert len(called) == 2
        before = len(faults)
        start = asyncio.create_task(runtime.start(one))
        for _ in range(steps):
            await asyncio.sleep(0)
        start.cancel()
        await asyncio.wait([start])
        tried = len(called) - 2
        assert tried in {0, 2}  # as soon as it can run, it is tried again, and not half of it
        assert len(ran) == (0 if future else len(called))
        assert not [fault for fault in faults[before:] if "does not run" in fault.detail]
        return tried

    tried = []
    for steps in range(STEPS):
        called.clear()
        ran.clear()
        tried.append(run_virtual(partial(main, steps=steps)))
    assert set(tried) == {0, 2}


@pytest.mark.parametrize("how", ["exit", "shut down"])
def test_what_was_started_by_hand_in_the_middle_of_a_start_is_latched_as_the_runtime_ends(how):
    log = Log()

    async def main():
        with suppress(SystemExit):
            async with Runtime(log=None) as runtime:
                below = robot(log, "below")
                beside = Ensemble("beside", policy=[0], actions={"Work": forever})
                top = Ensemble("top", policy=[0, 1], actions={"Below": below, "Beside": beside})
                start = asyncio.create_task(runtime.start(top))
                while below.life != "running":
                    await asyncio.sleep(0)
                below.publish_state(0)
                below.start()
                assert (log, top.life) == (["A"], "starting")
                if how == "exit":
                    runtime.abort(SystemExit(3))
                    below.publish_state(1)
                    assert log == ["A", "SAFE"]
                else:
                    asyncio.get_running_loop().call_soon(below.publish_state, 1)
        await asyncio.wait([start])

    run(main, virtual=True)
    assert log == ["A", "SAFE"]


def test_each_life_of_a_hierarchy_tells_that_those_below_are_stopped():
    async def main(runtime):
        told = {}
        runtime.modes.subscribe(lambda mode: told.setdefault(mode.ensemble, []).append(mode.mode))
        below = robot(Log(), "below")
        top = Ensemble(
            "top", policy=[0, 1], actions={"Below": below, "Rest": forever}, supervision=Restart(backoff=0.5)
        )
        await runtime.start(top)
        top.publish_state(0)
        below.publish_state(0)
        assert told == {"top": ["deciding"], "top/below": ["deciding"]}
        crash(top.control)
        await asyncio.sleep(2)
        assert (top.mode, below.mode) == ("deciding", "stopped")
        assert told["top/below"] == ["deciding", "safe", "stopped"]
        assert told["top"][-1] == "deciding"

    run_virtual(main)
