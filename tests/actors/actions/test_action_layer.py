"""The lives of actions: each has exactly one end, and no two are live at once."""

from __future__ import annotations

import asyncio
from collections import Counter

import pytest
from action_lives import Body, lives_of, robot, told
from hypothesis import given, strategies as st
from sentences import refused

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
from mdm.messages import Observation
from mdm.policies import DeterministicPolicy
from mdm.testing import probe, run_virtual

ENDS = {"succeeded", "failed", "preempted", "timed_out", "abandoned"}


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


@pytest.mark.parametrize("option", ["timeout", "grace"])
@pytest.mark.parametrize("seconds", [0, -1, float("inf"), float("nan"), "5", True])
def test_times_that_make_no_sense_are_refused(option, seconds):
    with refused(ConfigError):
        bind(lambda: None, **{option: seconds})
    if option == "grace":
        with refused(ConfigError):
            bind(lambda: None, grace=None)


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
        ensemble.action.lives.delegate()
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        ensemble.safety.endanger("mine", "why not", runtime.clock.now())
        assert ensemble.mode == "deciding"
        await runtime.stop(ensemble)
        assert did == []

    run_virtual(main)
