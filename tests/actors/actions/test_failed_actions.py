"""Actions that fail, take too long, do not end, or leave threads behind."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from functools import partial

import anyio
import pytest
from action_lives import Body, lives_of, robot, told
from hypothesis import given, strategies as st
from patience import PATIENCE
from sentences import refused

from mdm import Actor, ConfigError, PredicateManager, Runtime, VirtualClock, bind, run
from mdm.testing import probe, run_virtual


def test_failures_are_reported_and_the_loop_goes_on():
    async def main(runtime):
        def broken():
            raise ValueError("gripper stuck")

        ensemble = robot({"Plain": broken, "Async": Body("a", [], 1, error=OSError("no motor")), "Fine": lambda: None})
        await runtime.start(ensemble)
        lives, faults = lives_of(runtime), probe(runtime.faults)
        for state in (0, 1, 2):
            ensemble.publish_state(state)
            await asyncio.sleep(2)
        assert told(lives)[1::2] == [("Plain", "failed"), ("Async", "failed"), ("Fine", "succeeded")]
        assert [(fault.kind, fault.source) for fault in faults] == [("action", "robot/action")] * 2
        assert "action 'Plain' failed: ValueError: gripper stuck (at" in faults[0].detail
        assert "action 'Async' failed: OSError: no motor (at" in faults[1].detail

    run_virtual(main)


def test_timeouts():
    async def main(runtime):
        ensemble = robot({"A": bind(Body("A", []), timeout=2.0)})
        await runtime.start(ensemble)
        lives, faults = lives_of(runtime), probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(3)
        assert told(lives) == [("A", "running"), ("A", "timed_out")]
        assert faults[0].detail == "action 'A' timed out"
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        assert ensemble.action.live == ("A",)

    run_virtual(main)


@pytest.mark.parametrize(
    ("how", "end"), [("decision", "preempted"), ("stop", "preempted"), ("timeout", "timed_out"), ("end", "preempted")]
)
@pytest.mark.parametrize("again", [False, True])
def test_a_cancelled_action_that_returns_has_not_succeeded(how, end, again):
    """However often it swallows its cancellation, and whatever it does after that."""

    async def swallow():
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            if again:
                await asyncio.sleep(0.5)

    manager = PredicateManager()
    manager.latch("Arrived", set="A.succeeded", reset="A.preempted or A.timed_out")
    manager.event("Cut", "A.preempted or A.timed_out")

    async def main(runtime):
        timeout = 1.0 if how == "timeout" else None
        ensemble = robot({"A": bind(swallow, timeout=timeout), "B": lambda: None}, predicates=manager)
        await runtime.start(ensemble)
        lives, events = lives_of(runtime), probe(manager.events)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        if how == "decision":
            ensemble.publish_state(1)
        elif how == "stop":
            ensemble.stop()
        elif how == "end":
            await runtime.stop(ensemble)
        await asyncio.sleep(1)
        assert told(lives)[:2] == [("A", "running"), ("A", end)]
        if how != "end":
            assert [update.events for update in events] == [(f"A.{end}", "Cut")]
            assert manager.value("Arrived") is False

    run_virtual(main)


@given(st.sampled_from([0, 0.25, 0.5, 0.75]), st.sampled_from([0.1, 0.25, 0.3, 0.5, 0.9]), st.booleans())
def test_what_was_cancelled_never_succeeds_and_what_was_not_does(begins, lasts, swallows):
    async def act():
        try:
            await asyncio.sleep(lasts)
        except asyncio.CancelledError:
            if not swallows:
                raise

    async def main(runtime):
        ensemble = robot({"A": act, "B": lambda: None})
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        await asyncio.sleep(begins)
        ensemble.publish_state(0)
        await asyncio.sleep(0.4)
        ensemble.publish_state(1)
        await asyncio.sleep(1)
        assert told(lives)[1] == ("A", "succeeded" if lasts < 0.4 else "preempted")

    run_virtual(main)


@asynccontextmanager
async def held_later():
    yield


@contextmanager
def held():
    yield


async def generated_later():
    yield


def generated():
    yield


@pytest.mark.parametrize("bound", [lambda function: function, partial, lambda function: bind(function, timeout=1.0)])
@pytest.mark.parametrize(
    ("function", "kind"),
    [
        (generated_later, "an async generator function"),
        (generated, "a generator function"),
        (held_later, "an @asynccontextmanager function"),
        (held, "a @contextmanager function"),
    ],
)
def test_what_a_call_would_run_none_of_is_no_action(function, kind, bound):
    words = f"an action's target is a function that is called or awaited, but .* is {kind}, and a call would run none"
    with pytest.raises(ConfigError, match=words):
        robot({"A": bound(function)})
    with pytest.raises(ConfigError, match=words):
        robot({"A": lambda: None}, safe_action=bound(function) if bound is partial else function)

    async def main(runtime):
        ensemble = robot({"A": lambda: function()})  # noqa: PLW0108 - what it returns cannot be seen beforehand
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        ensemble.publish_state(0)
        assert told(lives) == [("A", "running"), ("A", "failed")]
        assert "of which nothing has run" in lives[1].detail

    run_virtual(main)


def test_an_action_may_be_a_method_of_what_enters_a_context_or_return_one_that_is_open():
    class Gripper:
        @contextmanager
        def held(self):
            yield

        def hold(self):
            with self.held():
                return self

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    async def main(runtime):
        ensemble = robot({"A": Gripper().hold})
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        ensemble.publish_state(0)
        assert told(lives) == [("A", "running"), ("A", "succeeded")]
        with refused(ConfigError):
            robot({"A": Gripper().held})

    run_virtual(main)


@pytest.mark.parametrize("group", [asyncio.TaskGroup, anyio.create_task_group])
def test_an_action_that_fails_by_a_task_group_says_which_error_it_was(group):
    async def drive():
        async def fail():
            raise ValueError("no way to the shelf")

        async with group() as tasks:
            (tasks.create_task(fail()) if group is asyncio.TaskGroup else tasks.start_soon(fail))

    async def main(runtime):
        ensemble = robot({"A": drive})
        await runtime.start(ensemble)
        lives, faults = lives_of(runtime), probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        assert told(lives)[-1] == ("A", "failed")
        for detail in (lives[-1].detail, faults[0].detail):
            assert "sub-exception): ValueError: no way to the shelf (at " in detail

    run_virtual(main)


class Panic(BaseException):
    """What native code may raise."""


@pytest.mark.parametrize("heard", [False, True])
@pytest.mark.parametrize("kind", [Panic, asyncio.CancelledError])
def test_a_plain_callback_that_raises_anything_at_all_has_failed(heard, kind):
    async def main(runtime):
        def panic():
            raise kind("in the driver")

        ensemble = robot({"A": panic, "B": lambda: None})
        await runtime.start(ensemble)
        lives, faults = lives_of(runtime) if heard else [], probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        ensemble.publish_state(1)
        assert ensemble.action.ended == {"failed": 1, "succeeded": 1}
        assert f"action 'A' failed: {kind.__name__}: in the driver" in faults[0].detail
        if heard:
            assert told(lives) == [("A", "running"), ("A", "failed"), ("B", "running"), ("B", "succeeded")]

    run_virtual(main)


def test_a_robot_that_brakes_for_four_seconds_is_waited_for():
    log = []

    async def main(runtime):
        ensemble = robot({"A": Body("A", log, cleanup=4.0), "B": Body("B", log)})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        ensemble.publish_state(1)
        await asyncio.sleep(4.5)
        assert log == ["A begins", "A ends", "B begins"]
        assert ensemble.action.ended == {"preempted": 1}

    run_virtual(main)


def test_a_callback_that_never_ends_is_abandoned():
    async def main():
        free = asyncio.Event()

        async def stubborn():
            while not free.is_set():
                try:
                    await free.wait()
                except asyncio.CancelledError:
                    continue

        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            ensemble = robot({"A": bind(stubborn, grace=0.5), "B": lambda: None})
            await runtime.start(ensemble)
            lives, faults = lives_of(runtime), probe(runtime.faults)
            ensemble.publish_state(0)
            await asyncio.sleep(1)
            ensemble.publish_state(1)
            await asyncio.sleep(0.4)
            assert told(lives) == [("A", "running")]
            await asyncio.sleep(0.2)
            assert told(lives)[1:] == [("A", "abandoned"), ("B", "running"), ("B", "succeeded")]
            assert faults[0].detail == "action 'A' abandoned: did not end within 0.5 s of being cancelled"
        free.set()
        await asyncio.sleep(1)
        assert told(lives)[1:] == [("A", "abandoned"), ("B", "running"), ("B", "succeeded")]

    run(main, virtual=True)


def handed_over(drive):
    return asyncio.get_running_loop().run_in_executor(None, drive)


def task_of(drive):
    return asyncio.get_running_loop().create_task(asyncio.to_thread(drive))


def shielded(drive):
    return asyncio.shield(asyncio.to_thread(drive))


def gathered(drive):
    return asyncio.gather(asyncio.to_thread(drive), asyncio.sleep(3600))


def without_the_loop(drive):
    return asyncio.Task(asyncio.to_thread(drive))


def a_moment_later(drive):
    loop = asyncio.get_running_loop()
    ended = loop.create_future()
    loop.call_soon(lambda: loop.run_in_executor(None, drive))
    return ended


@pytest.mark.parametrize(
    "begin", [asyncio.to_thread, handed_over, task_of, shielded, gathered, without_the_loop, a_moment_later]
)
def test_a_thread_of_an_action_ends_before_the_next_one_begins(begin):
    begun, free, log = threading.Event(), threading.Event(), []

    def drive():
        begun.set()
        free.wait(PATIENCE)
        log.append("A ends")

    async def main():
        ensemble = robot({"A": lambda: begin(drive), "B": lambda: log.append("B")})
        async with Runtime(log=None) as runtime:
            await runtime.start(ensemble)
            ensemble.publish_state(0)
            async with asyncio.timeout(PATIENCE):
                while not begun.is_set():
                    await asyncio.sleep(0.001)
                ensemble.publish_state(1)
                await asyncio.sleep(0.01)
                assert log == []
                free.set()
                while len(log) < 2:
                    await asyncio.sleep(0.001)
            assert log == ["A ends", "B"]
            assert ensemble.action.ended == {"preempted": 1, "succeeded": 1}
            assert runtime.abandoned == []

    run(main)


def test_work_whose_sensor_leads_to_an_action_does_not_wait_for_a_thread_of_that():
    free, log = threading.Event(), []

    def drive():
        asyncio.get_running_loop().run_in_executor(None, free.wait, PATIENCE)

    class Driver(Actor):
        def on_start(self):
            self.spawn(self.see(), lambda work: log.append("seen"))

        async def see(self):
            ensemble.publish_state(0)

    ensemble = robot({"A": drive, "B": drive})

    async def main():
        async with Runtime(log=None) as runtime:
            await runtime.start(ensemble)
            await runtime.start(Driver("driver"))
            async with asyncio.timeout(PATIENCE):
                while not log:
                    await asyncio.sleep(0.001)
            assert ensemble.action.ended == {"succeeded": 1}
            free.set()

    run(main)


class Elsewhere:
    """Stands for a function, as decorators' proxies do, and calls it in a thread."""

    def __init__(self, function):
        self.function = function
        self.__code__ = function.__code__

    def __call__(self):
        return handed_over(self.function)


class AtLast:
    """Returns nothing but None for long, and then what is to be awaited."""

    def __init__(self, function):
        self.function, self.left = function, 200

    def __call__(self):
        if self.left:
            self.left -= 1
            return None
        return handed_over(self.function)


@pytest.mark.parametrize("kind", [Elsewhere, AtLast])
def test_a_thread_is_the_action_s_whatever_the_function_looks_like_or_returned_before(kind):
    begun, free, log = threading.Event(), threading.Event(), []

    def drive():
        begun.set()
        free.wait(PATIENCE)
        log.append("A ends")

    async def main():
        ensemble = robot({"A": kind(drive), "B": lambda: log.append("B")})
        async with Runtime(log=None) as runtime:
            await runtime.start(ensemble)
            async with asyncio.timeout(PATIENCE):
                while not begun.is_set():
                    ensemble.publish_state(0)
                    await asyncio.sleep(0)
                ensemble.publish_state(1)
                await asyncio.sleep(0.01)
                assert log == []
                free.set()
                while len(log) < 2:
                    await asyncio.sleep(0.001)
            assert log == ["A ends", "B"]

    run(main)


def test_an_action_is_told_of_the_abandoned_thread_that_it_runs_beside():
    free, log = threading.Event(), []

    async def drive():
        await asyncio.to_thread(free.wait, PATIENCE)

    async def main(runtime):
        ensemble = robot({"A": drive, "B": lambda: log.append("B")})
        await runtime.start(ensemble)
        faults = probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(0)
        ensemble.publish_state(1)
        await asyncio.sleep(10)
        assert log == ["B"]
        assert ensemble.action.ended == {"abandoned": 1, "succeeded": 1}
        assert len(runtime.abandoned) == 1
        assert faults[-1].detail == "action 'B' begins while 'A', abandoned, still runs"
        free.set()

    run_virtual(main)


def test_an_action_and_a_safe_action_for_which_no_thread_is_had_fail_at_once():
    async def main(runtime):
        pool = ThreadPoolExecutor()
        pool.shutdown()

        async def brake():
            await asyncio.get_running_loop().run_in_executor(pool, print)

        ensemble = robot({"Drive": brake, "Rest": print}, safe_action=brake)
        await runtime.start(ensemble)
        lives, faults = lives_of(runtime), probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(0.1)
        assert [life for life in told(lives) if life[0] == "Drive"] == [("Drive", "running"), ("Drive", "failed")]
        assert told(lives).count(("safe action", "failed")) == 2
        assert ensemble.mode == "safe"
        assert [cause.kind for cause in ensemble.causes] == ["action", "safe_action"]
        assert not [fault for fault in faults if "abandoned" in fault.detail]

    run_virtual(main)
