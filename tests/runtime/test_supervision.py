"""Supervision: what a failure means, how often an actor starts anew, and how an error reads."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from contextlib import nullcontext

import anyio
import numpy as np
import pytest
from hypothesis import given, strategies as st
from recorded import Fragile, Recorded, tell
from sentences import refused

import mdm
from mdm import Actor, ActorFailure, ConfigError, Restart
from mdm.runtime.supervision import RestartBudget, describe
from mdm.testing import crash, probe, run_virtual


def test_escalation_ends_the_block_with_the_cause():
    log, faults = [], []

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        parent = Recorded("parent", log)
        parent.add(Fragile("child", log))
        await runtime.start(parent)
        tell(runtime, 1)
        await asyncio.sleep(3600)
        pytest.fail("the block goes on")

    with refused(ActorFailure):
        run_virtual(main)
    assert [(fault.source, fault.kind) for fault in faults][:2] == [
        ("parent/child", "exception"),
        ("parent", "exception"),
    ]
    assert "ValueError: 1 is odd (at" in faults[0].detail
    assert log[-2:] == [("stop", "parent/child"), ("stop", "parent")]


def test_a_failure_is_told_above_in_the_words_of_who_failed_first():
    faults = []

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        top, middle = Actor("top"), Actor("middle")
        top.add(middle)
        middle.add(Fragile("low", []))
        await runtime.start(top)
        tell(runtime, 1)
        await asyncio.sleep(3600)

    with pytest.raises(ActorFailure) as raised:
        run_virtual(main)
    told = "actor 'top/middle/low' failed: 1 is odd"
    assert str(raised.value) == told
    assert isinstance(raised.value.__cause__, ValueError)
    assert [fault.detail for fault in faults[1:]] == [f"ActorFailure: {told}"] * 2


def test_supervision_stop_leaves_the_others_alone():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log, supervision="stop")
        await runtime.start(actor)
        lives = probe(runtime.lives)
        tell(runtime, 1)
        await asyncio.sleep(0.1)
        assert actor.life == "failed"
        assert actor.failing
        tell(runtime, 2)
        assert ("handled", 2) not in log
        assert [change.state for change in lives] == ["stopping", "failed"]

    run_virtual(main)


def test_supervision_restart_has_a_limit_and_a_growing_back_off():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log, supervision=Restart(limit=2, within=10, backoff=1))
        await runtime.start(actor)
        times = []
        for wait in (1, 2):
            tell(runtime, 1)
            tell(runtime, 4)  # nobody takes it
            began = runtime.clock.time()
            while actor.life != "running" or actor.failing:
                await asyncio.sleep(0.25)
            times.append(runtime.clock.time() - began)
            assert times[-1] == pytest.approx(wait, abs=0.3)
            tell(runtime, 2)
        assert actor.statistics().restarts == 2
        await asyncio.sleep(60)  # the window passes, and the budget is whole again
        tell(runtime, 1)
        await asyncio.sleep(5)
        assert actor.life == "running"
        tell(runtime, 1)
        await asyncio.sleep(5)
        tell(runtime, 1)
        await asyncio.sleep(60)
        pytest.fail("one failure too many escalates")

    with refused(ActorFailure):
        run_virtual(main)
    assert log.count(("handled", 2)) == 2
    assert ("handled", 4) not in log


def test_a_failure_too_many_while_it_waits_to_restart_ends_it():
    log = []

    async def main(runtime):
        actor = Recorded("actor", log, supervision=Restart(limit=1, within=60, backoff=2))
        await runtime.start(actor)
        crash(actor)
        await asyncio.sleep(0.5)
        crash(actor)
        await asyncio.sleep(60)
        pytest.fail("the block goes on")

    with refused(ActorFailure):
        run_virtual(main)
    assert log == [("start", "actor"), ("stop", "actor")]


def test_what_waits_to_restart_does_not_where_what_is_above_it_has_failed():
    log = []

    class Slow(Actor):
        async def on_stopping(self):
            await asyncio.sleep(5)

    async def main(runtime):
        parent, child = Recorded("parent", log), Recorded("child", log, supervision=Restart(backoff=0.5))
        parent.add(child)
        await runtime.start(parent)
        await runtime.start(Slow("slow"))
        crash(child)
        crash(parent)
        await asyncio.sleep(60)

    with refused(ActorFailure):
        run_virtual(main)
    ends = [("stop", "parent/child"), ("stop", "parent")]
    assert log == [("start", "parent"), ("start", "parent/child"), *ends]


def test_a_restart_adds_children_anew():
    log = []

    class Parent(Recorded):
        def on_start(self):
            super().on_start()
            self.add(Recorded("child", log))

    async def main(runtime):
        parent = Parent("parent", log, supervision=Restart(backoff=0.1))
        await runtime.start(parent)
        crash(parent)
        await asyncio.sleep(1)
        assert parent.life == "running"
        assert [child.life for child in parent.children] == ["running"]

    run_virtual(main)
    assert log == [("start", "parent"), ("start", "parent/child"), ("stop", "parent/child"), ("stop", "parent")] * 2


@given(
    st.integers(0, 4),
    st.floats(1, 100),
    st.floats(0.1, 10),
    st.lists(st.floats(0, 60), max_size=30),
)
def test_a_budget_is_that_of_a_sliding_window(limit, within, backoff, pauses):
    policy = Restart(limit=limit, within=within, backoff=backoff, max_backoff=4 * backoff)
    budget, granted, now = RestartBudget(policy), [], 0
    for pause in pauses:
        now += round(pause * 1e9)
        recent = [time for time in granted if now - time <= within * 1e9]
        if len(recent) < limit:
            assert budget.delay(now) == min(backoff * 2 ** len(recent), 4 * backoff)
            granted.append(now)
        else:
            assert budget.delay(now) is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"limit": "x"}, "limit of Restart(...) is a whole number from 0 on, not 'x'"),
        ({"limit": -1}, "from 0 on, not -1"),
        ({"limit": 2.5}, "from 0 on, not 2.5"),
        ({"within": 0}, "within of Restart(...) is a number of seconds above 0"),
        ({"within": float("nan")}, "above 0 and at most 10^9, not nan"),
        ({"backoff": -0.1}, "backoff of Restart(...) is a number of seconds from 0 to 10^9, not -0.1"),
        ({"max_backoff": None}, "max_backoff of Restart(...) is a number of seconds from 0 to 10^9, not None"),
    ],
)
def test_a_restart_that_counts_nothing_is_refused(options, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        Restart(**options)


def test_an_error_reads_with_its_place():
    try:
        raise LookupError("no device")
    except LookupError as error:
        text = describe(error)
    assert re.fullmatch(r"LookupError: no device \(at .*test_supervision\.py:\d+\)", text)
    assert describe(LookupError("never raised")) == "LookupError: never raised"


class Mute(Exception):
    def __str__(self):
        return self.args[7]


def test_an_error_whose_text_cannot_be_had_is_a_failure_as_any_other():
    faults = []

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        parent, child = Actor("parent"), Actor("child")
        parent.add(child)
        await runtime.start(parent)
        crash(child, Mute("lost"))
        assert (child.failing, parent.failing, runtime.ending) == (True, True, True)
        await asyncio.sleep(3600)

    told = "its text cannot be read: that raises IndexError"
    with refused(ActorFailure):
        run_virtual(main)
    assert faults[0].detail == f"Mute: {told}"


def test_a_budget_of_thousands_of_restarts_goes_on():
    budget = RestartBudget(Restart(limit=3000, within=1e9, backoff=0.1, max_backoff=5.0))
    assert [budget.delay(0) for _ in range(3001)][-2:] == [5.0, None]


@pytest.mark.parametrize("hook", ["on_start", "on_stop", "on_stopping", "handler"])
def test_an_actor_that_raises_a_cancellation_has_failed_alone(hook):
    """A plain function that reads a cancelled future's result raises `CancelledError`, and cancels nobody."""

    def broken(*_):
        raise asyncio.CancelledError

    async def stopping(_):
        broken()

    async def main(runtime):
        broken_hook = {hook: stopping if hook == "on_stopping" else broken} if hook != "handler" else {}
        actor = type("Broken", (Actor,), broken_hook)("broken", supervision="stop")
        other = Actor("other")
        await runtime.start(other)
        faults = []
        runtime.faults.subscribe(faults.append)
        if hook == "on_start":
            with refused(ActorFailure):
                await runtime.start(actor)
        else:
            await runtime.start(actor)
            if hook == "handler":
                actor.call_later(1, broken)
                await asyncio.sleep(2)
                assert actor.life == "failed"
            await runtime.stop(actor)
            assert ["CancelledError" in fault.detail for fault in faults] == [True]
        assert other.life == "running"

    run_virtual(main)


@pytest.mark.parametrize("kind", [ValueError, asyncio.CancelledError, GeneratorExit, SystemExit])
def test_what_is_raised_where_a_failure_is_taken_in_is_told_and_changes_nothing_else(kind):
    class Broken(Actor):
        def on_failing(self, error):
            raise kind("one more")

    async def main(runtime):
        faults = probe(runtime.faults)
        actor = Broken("actor", supervision=Restart(backoff=1.0))
        await runtime.start(actor)
        crash(actor)
        assert [fault.detail.partition(" (")[0] for fault in faults[1:]] == [f"{kind.__name__}: one more"]
        await asyncio.sleep(0.5)
        assert actor.life == "restarting"

    with pytest.raises(SystemExit, match="one more") if kind is SystemExit else nullcontext():
        run_virtual(main)


def test_the_errors_of_a_group_are_told_each_with_its_place_and_group_within_group():
    def raised(error):
        try:
            raise error
        except BaseException as caught:
            return caught

    inner = ExceptionGroup("two", [raised(KeyError("shelf")), LookupError("never raised")])
    line = inner.exceptions[0].__traceback__.tb_lineno
    group = raised(ExceptionGroup("at once", [raised(ValueError("no way")), raised(inner)]))
    place = f"(at {__file__}:{line})"
    told = f"ValueError: no way {place}; KeyError: 'shelf' {place}; LookupError: never raised"
    assert describe(group) == f"ExceptionGroup: at once (2 sub-exceptions): {told}"


def test_of_a_large_or_deep_group_the_first_errors_are_told():
    large = ExceptionGroup("many", [ValueError(number) for number in range(1000)])
    first = "; ".join(f"ValueError: {number}" for number in range(5))
    assert describe(large) == f"ExceptionGroup: many (1000 sub-exceptions): {first}; and 995 more"
    deep = ValueError("at the bottom")
    for _ in range(5000):
        deep = ExceptionGroup("level", [deep])
    assert describe(deep) == "ExceptionGroup: level (1 sub-exception): ValueError: at the bottom"


@pytest.mark.parametrize("group", [asyncio.TaskGroup, anyio.create_task_group])
def test_an_actor_that_fails_by_a_task_group_says_which_error_it_was(group):
    faults = []

    async def work():
        async def fail():
            raise ValueError("no way to the shelf")

        async with group() as tasks:
            if group is asyncio.TaskGroup:
                tasks.create_task(fail())
            else:
                tasks.start_soon(fail)

    class Working(Actor):
        def on_start(self):
            self.spawn(work())

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        await runtime.start(Working("one"))
        await asyncio.sleep(1)

    with refused(ActorFailure):
        run_virtual(main)
    assert "ValueError: no way to the shelf (at " in faults[0].detail
    assert faults[0].detail.endswith(f"{__file__}:{fail_line(work)})")


def fail_line(work):
    return work.__code__.co_firstlineno + 2


def test_the_place_of_an_error_is_the_program_s_own_line(tmp_path):
    def told(function):
        try:
            function()
        except Exception as error:
            return describe(error)
        raise AssertionError

    def here(function):
        return f"(at {__file__}:{function.__code__.co_firstlineno + 1})"

    def unknown():
        mdm.PredicateManager().sensor("Seen", max_age=-1)

    def python():
        json.loads("{")

    def installed():
        np.zeros((2, 2)).reshape(3)

    for function in (unknown, python, installed):
        assert told(function).endswith(here(function))
    program = """
import mdm
from mdm.runtime.supervision import describe
try:
    mdm.load_model("missing")
except mdm.Error as error:
    print(describe(error.with_traceback(error.__traceback__.tb_next)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert "missing" in done.stdout
    assert "(at " not in done.stdout  # no line of the program has led to it
