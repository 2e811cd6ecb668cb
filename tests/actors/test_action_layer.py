"""The lives of actions: each has exactly one end, and no two are live at once."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter

import pytest
from hypothesis import given, strategies as st

from mdm import (
    ConfigError,
    Ensemble,
    ObservationFactor,
    ObservationLayer,
    PredicateManager,
    Runtime,
    VirtualClock,
    bind,
    run,
)
from mdm.messages import ActionLife, Observation
from mdm.policies import DeterministicPolicy
from mdm.testing import probe, run_virtual

ENDS = {"succeeded", "failed", "preempted", "timed_out", "abandoned"}


def robot(actions, **options):
    return Ensemble("robot", policy=DeterministicPolicy(list(range(len(actions)))), actions=actions, **options)


def lives_of(runtime, path="robot"):
    return probe(runtime.channel(f"{path}/lives", ActionLife))


def told(lives):
    return [(life.action, life.status) for life in lives]


class Body:
    """An async action that tells when it begins and ends, and counts how many of its kind run at once."""

    running = 0
    most = 0

    def __init__(self, name, log, seconds=3600.0, cleanup=0.0, error=None):
        self.name, self.log, self.seconds, self.cleanup, self.error = name, log, seconds, cleanup, error

    async def __call__(self):
        self.log.append(f"{self.name} begins")
        try:
            await asyncio.sleep(self.seconds)
            if self.error is not None:
                raise self.error
        finally:
            await asyncio.sleep(self.cleanup)
            self.log.append(f"{self.name} ends")


def test_a_new_action_waits_until_the_old_one_has_ended():
    log = []

    async def main(runtime):
        ensemble = robot({"A": Body("A", log, cleanup=0.5), "B": Body("B", log)})
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        ensemble.publish_state(1)
        await asyncio.sleep(0.4)
        assert log == ["A begins"]
        assert ensemble.action.live == ("A",)
        await asyncio.sleep(0.2)
        assert log == ["A begins", "A ends", "B begins"]
        assert told(lives) == [("A", "running"), ("A", "preempted"), ("B", "running")]

    run_virtual(main)


def test_there_and_back_again_while_the_first_ends():
    log = []

    async def main(runtime):
        ensemble = robot({"A": Body("A", log, cleanup=0.5), "B": Body("B", log)})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        ensemble.publish_state(1)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        assert log == ["A begins", "A ends", "A begins"]  # B never began
        assert ensemble.action.skipped == 1

    run_virtual(main)


@pytest.mark.parametrize("on_repeat", ["continue", "restart"])
def test_the_same_action_again(on_repeat):
    log = []

    async def main(runtime):
        ensemble = robot({"A": bind(Body("A", log), on_repeat=on_repeat)})
        await runtime.start(ensemble)
        for _ in range(3):
            ensemble.publish_state(0)
            await asyncio.sleep(1)
        begun = log.count("A begins")
        assert begun == (1 if on_repeat == "continue" else 3)

    run_virtual(main)


def test_a_plain_function_is_called_again_and_may_take_the_message():
    calls = []

    async def main(runtime):
        ensemble = robot({"A": lambda action: calls.append((action.epoch, action.index))})
        await runtime.start(ensemble)
        for _ in range(3):
            ensemble.publish_state(0)
        assert calls == [(0, 0), (1, 0), (2, 0)]
        assert ensemble.action.ended == {"succeeded": 3}
        assert ensemble.action.latency.count == 3

    run_virtual(main)


def test_an_action_whose_last_step_brings_about_its_repetition_is_started_again():
    log = []

    async def main(runtime):
        async def go():
            log.append("go")
            await asyncio.sleep(1)
            ensemble.publish_state(0)

        ensemble = robot({"Go": go})
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        ensemble.publish_state(0)
        await asyncio.sleep(3.5)
        assert log == ["go"] * 4
        assert told(lives) == [("Go", "running"), ("Go", "succeeded")] * 3 + [("Go", "running")]

    run_virtual(main)


def test_an_action_whose_last_step_brings_about_another_one_has_succeeded():
    async def main(runtime):
        async def go():
            await asyncio.sleep(1)
            ensemble.publish_state(1)

        ensemble = robot({"Go": go, "Rest": lambda: None})
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        ensemble.publish_state(0)
        await asyncio.sleep(2)
        assert told(lives) == [("Go", "running"), ("Go", "succeeded"), ("Rest", "running"), ("Rest", "succeeded")]

    run_virtual(main)


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


@pytest.mark.parametrize("make", ["async generator", "generator"])
def test_a_generator_is_no_action(make):
    async def later():
        yield

    def now():
        yield

    function = later if make == "async generator" else now
    with pytest.raises(ConfigError, match=f"ensembles.robot.actions.A: .* is an? {make} function"):
        robot({"A": function})

    async def main(runtime):
        ensemble = robot({"A": lambda: function()})  # noqa: PLW0108 - what it returns cannot be seen beforehand
        await runtime.start(ensemble)
        lives = lives_of(runtime)
        ensemble.publish_state(0)
        assert told(lives) == [("A", "running"), ("A", "failed")]
        assert "of which nothing has run" in lives[1].detail

    run_virtual(main)


@pytest.mark.parametrize("option", ["timeout", "grace"])
@pytest.mark.parametrize("seconds", [0, -1, float("inf"), float("nan"), "5", True])
def test_times_that_make_no_sense_are_refused(option, seconds):
    with pytest.raises(ConfigError, match=f"{option} is a number of seconds above 0 and at most 10.9, not {seconds!r}"):
        bind(lambda: None, **{option: seconds})
    if option == "grace":
        with pytest.raises(ConfigError, match="grace is a number of seconds"):
            bind(lambda: None, grace=None)


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


def test_a_concurrent_action_runs_beside_the_others():
    log = []

    async def main(runtime):
        ensemble = robot({"Drive": Body("Drive", log), "Speak": bind(Body("Speak", log, 2), concurrent=True)})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        ensemble.publish_state(1)
        await asyncio.sleep(1)
        assert ensemble.action.live == ("Drive", "Speak")
        await asyncio.sleep(2)
        assert log == ["Drive begins", "Speak begins", "Speak ends"]

    run_virtual(main)


def test_ends_are_events_for_latches_and_observations():
    async def main(runtime):
        manager = PredicateManager()
        manager.latch("Patrolled", set="Patrol.succeeded", reset="Patrol.running")
        ensemble = Ensemble(
            "robot", policy=DeterministicPolicy([0]), actions={"Patrol": Body("p", [], 1)}, predicates=manager
        )
        layer = ObservationLayer([ObservationFactor("end", ["Patrol.succeeded", "Patrol.failed"])], manager)
        await runtime.start(ensemble)
        await runtime.start(layer)
        seen = probe(runtime.channel("observation/observation", Observation))
        ensemble.publish_state(0)
        await asyncio.sleep(2)
        assert manager.value("Patrolled") is True
        assert [message.index for message in seen] == [0]

    run_virtual(main)


def test_stop_during_an_action_and_a_quick_start():
    log = []

    async def main(runtime):
        ensemble = robot({"A": Body("A", log, cleanup=0.5)})
        await runtime.start(ensemble)
        idle = []
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        ensemble.when_idle(lambda: idle.append(runtime.clock.time()))
        ensemble.stop()
        ensemble.publish_state(0)  # nobody decides
        await asyncio.sleep(1)
        assert log == ["A begins", "A ends"]
        assert idle == [1.5]
        ensemble.start()
        await asyncio.sleep(0.1)
        assert log[2:] == ["A begins"]
        ensemble.stop()
        ensemble.start()  # overtakes the stop
        await asyncio.sleep(2)
        assert log[2:] == ["A begins", "A ends", "A begins"]

    run_virtual(main)


@given(st.data())
def test_random_lives(data):
    """Never two live at once; every life ends exactly once; the next begins when the one before has ended."""
    log, live, most = [], set(), []

    def body(seconds, cleanup, fails, obeys):
        async def act():
            token = object()
            live.add(token)
            most.append(len(live))
            try:
                await asyncio.sleep(seconds)
                if fails:
                    raise ValueError("fails")
            except asyncio.CancelledError:
                if not obeys:
                    live.discard(token)  # abandoned is not live
                    await asyncio.sleep(30)
                raise
            finally:
                try:
                    await asyncio.sleep(cleanup)
                finally:
                    live.discard(token)

        return act

    def plain(fails):
        def act():
            log.append("called")
            if fails:
                raise ValueError("fails")

        return act

    count = data.draw(st.integers(1, 4))
    actions = {}
    for index in range(count):
        target = (
            plain(data.draw(st.booleans()))
            if data.draw(st.booleans())
            else body(
                data.draw(st.sampled_from([0, 0.5, 2, 100])),
                data.draw(st.sampled_from([0, 0.3])),
                data.draw(st.booleans()),
                data.draw(st.sampled_from([True, True, True, False])),
            )
        )
        timeout = data.draw(st.sampled_from([None, None, 1.0]))
        repeat = data.draw(st.sampled_from(["continue", "restart"]))
        actions[f"A{index}"] = bind(target, timeout=timeout, grace=1.0, on_repeat=repeat)

    async def main():
        before = asyncio.all_tasks()
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            ensemble = robot(actions)
            await runtime.start(ensemble)
            lives = lives_of(runtime)
            for _ in range(data.draw(st.integers(1, 12))):
                step = data.draw(st.sampled_from(["state", "state", "state", "stop", "start", "reset"]))
                if step == "state":
                    ensemble.publish_state(data.draw(st.integers(0, count - 1)))
                else:
                    getattr(ensemble, step)()
                await asyncio.sleep(data.draw(st.sampled_from([0, 0, 0.1, 0.7, 3])))
        for work in runtime.abandoned:
            await asyncio.wait([work.task])
        assert asyncio.all_tasks() == before
        current = None
        for life in lives:
            if life.status == "running":
                assert current is None, "two lives at once"
                current = life.life
            else:
                assert life.status in ENDS
                assert current == life.life, "a life that ended twice, or never began"
                current = None
        assert current is None, "a life without an end"
        counted = Counter(life.status for life in lives)
        assert counted["running"] == ensemble.action.started == sum(ensemble.action.ended.values())

    run(main, virtual=True)
    assert max(most, default=0) <= 1


def handed_over(drive):
    return asyncio.get_running_loop().run_in_executor(None, drive)


def task_of(drive):
    return asyncio.get_running_loop().create_task(asyncio.to_thread(drive))


def shielded(drive):
    return asyncio.shield(asyncio.to_thread(drive))


def gathered(drive):
    return asyncio.gather(asyncio.to_thread(drive), asyncio.sleep(3600))


@pytest.mark.parametrize("begin", [asyncio.to_thread, handed_over, task_of, shielded, gathered])
def test_a_thread_of_an_action_ends_before_the_next_one_begins(begin):
    begun, free, log = threading.Event(), threading.Event(), []

    def drive():
        begun.set()
        free.wait(10)
        log.append("A ends")

    async def main():
        ensemble = robot({"A": lambda: begin(drive), "B": lambda: log.append("B")})
        async with Runtime(log=None) as runtime:
            await runtime.start(ensemble)
            ensemble.publish_state(0)
            async with asyncio.timeout(10):
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


def test_an_action_is_told_of_the_abandoned_thread_that_it_runs_beside():
    free, log = threading.Event(), []

    async def drive():
        await asyncio.to_thread(free.wait, 10)

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


def test_a_layer_that_is_barred_begins_nothing_and_lets_what_lives_go_on():
    async def main(runtime):
        did = []

        async def walk():
            did.append("walk begins")
            await asyncio.sleep(10.0)
            did.append("walk ends")

        ensemble = robot({"walk": walk, "wave": lambda: did.append("wave")}, safe_action=lambda: did.append("SAFE"))
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        ensemble.action.bar(barred=True)
        ensemble.publish_state(1)
        await asyncio.sleep(11.0)
        assert did == ["walk begins", "walk ends"]
        assert ensemble.action.skipped == 1
        ensemble.action.bar(barred=False)
        ensemble.publish_state(1)
        assert did[2:] == ["wave"]
        ensemble.action.bar(barred=True)
        ensemble.safety.endanger("mine", "why not", runtime.clock.now())
        assert did[3:] == ["SAFE"]  # it runs all the same
        ensemble.release()
        ensemble.publish_state(1)
        assert did[4:] == []  # still barred
        ensemble.action.bar(barred=False)
        ensemble.publish_state(1)
        assert did[4:] == ["wave"]

    run_virtual(main)


def test_an_idle_layer_does_nothing_not_even_the_safe_action():
    async def main(runtime):
        did = []
        ensemble = robot({"walk": lambda: did.append("walk")}, safe_action=lambda: did.append("SAFE"))
        ensemble.action.idle = True
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        ensemble.safety.endanger("mine", "why not", runtime.clock.now())
        assert ensemble.mode == "deciding"
        await runtime.stop(ensemble)
        assert did == []

    run_virtual(main)
