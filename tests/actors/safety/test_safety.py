"""Safe modes: what each cause does to the live action, and what is decided; and the safe action itself."""

from __future__ import annotations

import asyncio
import threading

import pytest
from patience import PATIENCE
from places import ROOT
from safe_robots import Log, certain, forever, robot, sensed
from sentences import refused

from mdm import (
    ActorFailure,
    ConfigError,
    Ensemble,
    Error,
    FixedRate,
    ObservationFactor,
    PredicateManager,
    Runtime,
    StateFactor,
    bind,
    run,
)
from mdm.actors import EnsembleStatistics
from mdm.policies import AlphaVectors
from mdm.testing import crash, probe, run_virtual

# -- The safe action and what is decided ---------------------------------------------------------------------------


@pytest.mark.parametrize("safe", ["plain", "async"])
@pytest.mark.parametrize("action", ["plain", "async"])
def test_an_impossible_observation_runs_the_safe_action_to_its_end_before_what_is_decided(safe, action):
    log = Log()

    async def main(runtime):
        one = robot(
            log,
            policy=AlphaVectors([[0.0, 0.0]], [0], 1),
            model=certain(),
            actions={0: log.plain("A") if action == "plain" else log.slow("A", 1e6)},
            safe_action=log.plain("SAFE") if safe == "plain" else log.slow("SAFE", 3.0),
            on_impossible="safe_action",
        )
        await runtime.start(one)
        await asyncio.sleep(0.1)
        log.clear()
        one.publish_observation(1)
        assert "A begins" not in log
        await asyncio.sleep(5)
        runs = ["SAFE"] if safe == "plain" else ["SAFE begins", "SAFE ends"]
        acts = ["A"] if action == "plain" else ["A begins"]
        assert log == [*(["A ends"] if action == "async" else []), *runs, *acts]
        assert one.control.belief[0] == 0.0  # goes on from the prediction
        assert one.mode == "deciding"

    run_virtual(main)


def test_what_was_decided_in_the_same_turn_does_not_start():
    log = Log()

    def broken():
        log.append("B")
        raise LookupError

    async def main(runtime):
        one = robot(log, actions={"A": log.plain("A"), "B": broken})
        await runtime.start(one)

        def both(_):
            one.publish_state(1)
            one.publish_state(0)

        channel = runtime.channel("both", int)
        channel.subscribe(both)
        channel.publish(1)
        assert log == ["B", "SAFE"]
        assert one.action.skipped == 1

    run_virtual(main)


def test_a_tick_with_input_too_old_drives_no_more():
    log = Log()

    async def main(runtime):
        manager = PredicateManager()
        seen = manager.sensor("Seen", max_age=1.0)
        manager.event("E0", "Seen")
        manager.event("E1", "not Seen")
        one = robot(
            log,
            policy=AlphaVectors([[0.0, 0.0]], [0], 1),
            model=certain(),
            actions={0: log.plain("A")},
            predicates=manager,
            observations=[ObservationFactor("o", ["E0", "E1"])],
            drive=FixedRate(1.0),
        )
        await runtime.start(one)
        seen.set(True)
        await asyncio.sleep(0.5)
        log.clear()
        await asyncio.sleep(10)
        assert log.count("SAFE") == 1
        assert log[-1] == "SAFE"
        log.clear()
        seen.set(True)
        await asyncio.sleep(0.9)
        assert log == ["A"]

    run_virtual(main)


@pytest.mark.parametrize("how", ["raises", "raises later", "times out", "is abandoned"])
def test_an_action_that_fails_makes_safe_until_the_next_state(how):
    log = Log()

    async def later():
        await asyncio.sleep(0.1)
        raise LookupError

    async def stubborn():
        while True:
            try:
                await asyncio.sleep(1e6)
            except asyncio.CancelledError:
                log.append("ignored")
                if runtime_ends:
                    raise

    def at_once():
        raise LookupError

    target = {
        "raises": at_once,
        "raises later": later,
        "times out": bind(forever, timeout=1.0),
        "is abandoned": bind(stubborn, timeout=1.0, grace=1.0),
    }[how]
    runtime_ends = []

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": target, "B": log.plain("B")})
        modes = probe(runtime.modes)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(10)
        assert [entry for entry in log if entry != "ignored"] == ["SAFE"]
        assert [cause.kind for cause in one.causes] == ["action"]
        sensor.set(True)
        assert log[-1] == "B"
        assert [mode.mode for mode in modes] == ["deciding", "safe", "deciding"]
        runtime_ends.append(True)
        for work in runtime.abandoned:
            work.cancel()

    run_virtual(main)


def test_an_action_that_fails_is_the_system_s_own_affair_where_its_end_is_used_or_the_option_says_so():
    log = Log()

    def broken():
        raise LookupError

    async def main(runtime):
        manager = PredicateManager()
        sensor = manager.sensor("S")
        manager.latch("Failed", set="A.failed", reset="S")
        one = robot(
            log,
            predicates=manager,
            states=[StateFactor("f", ["Failed"])],
            actions={"A": broken, "B": log.plain("B")},
        )
        await runtime.start(one)
        assert sensor is not None
        assert log == ["B"]
        assert one.mode == "deciding"

    run_virtual(main)
    assert log == ["B", "SAFE"]

    async def goes_on(runtime):
        one, _, sensor = sensed(log, actions={"A": broken, "B": log.plain("B")}, on_failed_action="continue")
        await runtime.start(one)
        sensor.set(False)
        assert one.mode == "deciding"

    run_virtual(goes_on)


def test_a_live_action_that_does_not_end_is_abandoned_and_the_safe_action_runs():
    log = Log()
    free = asyncio.Event()

    async def stubborn():
        while not free.is_set():
            try:
                await free.wait()
            except asyncio.CancelledError:
                log.append("ignored")

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, actions={"A": bind(stubborn, grace=2.0), "B": log.plain("B")})
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2.5)
        assert log == ["ignored"]
        await asyncio.sleep(1.0)
        assert log == ["ignored", "SAFE"]
        free.set()

    run_virtual(main)


@pytest.mark.parametrize("layer", ["control", "action", "state"])
def test_a_failing_layer_latches_within_its_turn(layer):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log)
        await runtime.start(one)
        sensor.set(False)
        crash(getattr(one, layer), Error("broken"))
        assert log == ["A", "SAFE"]
        sensor.set(True)
        assert log == ["A", "SAFE"]
        await asyncio.sleep(1)

    with refused(ActorFailure):
        run_virtual(main)
    assert log == ["A", "SAFE"]


@pytest.mark.parametrize("grace", [PATIENCE, 0.1])
def test_a_thread_of_the_live_action_has_ended_or_is_abandoned_when_the_safe_action_runs(grace):
    log, free = Log(), threading.Event()

    def drive():
        free.wait(PATIENCE)
        log.append("thread ends")

    async def until(condition):
        async with asyncio.timeout(PATIENCE):
            while not condition():
                await asyncio.sleep(0.001)

    async def main():
        action = bind(lambda: asyncio.to_thread(drive), grace=grace)
        one, _, sensor = sensed(log, max_age=0.2, actions={"A": action, "B": log.plain("B")})
        async with Runtime(log=None) as runtime:
            await runtime.start(one)
            sensor.set(False)
            await until(lambda: one.mode == "safe")
            assert log == []
            if grace > 1:
                free.set()
            await until(lambda: "SAFE" in log)
            assert len(runtime.abandoned) == (grace < 1)
            free.set()
            await until(lambda: len(log) == 2 and not runtime.abandoned)
            assert log == (["SAFE", "thread ends"] if grace < 1 else ["thread ends", "SAFE"])

    run(main)


# -- The safe action itself ----------------------------------------------------------------------------------------


def test_a_safe_action_that_fails_is_tried_once_more_then_it_is_an_emergency():
    log = Log()

    def broken():
        log.append("SAFE")
        raise LookupError("no brakes")

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=broken)
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        assert log[:3] == ["A", "SAFE", "SAFE"]
        assert log[3] == "motors off"
        assert "failed twice: action 'safe action' failed: LookupError: no brakes" in next(
            fault.detail for fault in faults if fault.kind == "safe_action"
        )
        sensor.set(True)
        assert one.mode == "safe"  # until a person says so
        one.release()
        assert log[-1] == "B"

    run_virtual(main, emergency=log.plain("motors off"))


def test_the_safe_action_has_a_limit_of_its_own():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=log.slow("SAFE", 1e6), safe_timeout=2.0)
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(10)
        assert log == ["A", "SAFE begins", "SAFE ends", "SAFE begins", "SAFE ends"]
        assert [fault.detail for fault in faults if fault.kind == "action"] == ["action 'safe action' timed out"] * 2
        statistics = one.statistics()
        assert isinstance(statistics, EnsembleStatistics)
        assert (statistics.mode, statistics.safe_actions) == ("safe", 2)
        assert {cause.kind for cause in statistics.causes} == {"stale_input", "safe_action"}

    run_virtual(main)


# -- Options -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"on_lost_input": "panic"}, "on_lost_input: 'panic' is not one of 'safe', 'continue'"),
        ({"on_unknown": "safe", "safe_action": None}, "on_unknown asks for the safe action, but there is none"),
        ({"on_failed_action": "safe", "safe_action": None}, "on_failed_action asks for the safe action"),
        ({"after_safe": "predict"}, "after_safe: 'predict' is not one of 'reset', 'keep'"),
        ({"after_safe": ["reset"]}, "after_safe: a list is not one of 'reset', 'keep'"),
        (
            {"safe_timeout": 0},
            "safe_timeout: a number of seconds above 0 and at most 1,000,000,000 was expected, not 0",
        ),
        ({"on_lost": "safe"}, "there is no option 'on_lost'"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        robot(Log(), **options)


@pytest.mark.parametrize("named", [True, False])
def test_the_safe_action_is_no_ensemble(named):
    below = Ensemble("below", policy=[0], actions={"A": print})
    with refused(ConfigError) as e:
        robot(Log(), actions={"A": below, "B": print}, safe_action="A" if named else below)
    assert e.value.key == "ensembles.robot.safe_action"


def test_what_was_decided_does_not_start_once_its_state_has_turned_unknown():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log)
        await runtime.start(one)
        turn = runtime.channel("turn", list)
        turn.subscribe(lambda values: [sensor.set(value) for value in values])
        turn.publish([True, None])
        assert log == ["SAFE"]
        assert [cause.kind for cause in one.causes] == ["unknown_input"]
        sensor.set(True)
        assert log == ["SAFE", "B"]

    run_virtual(main)


def test_the_end_of_an_ensemble_below_takes_what_the_page_says():
    async def act():
        pass

    below = Ensemble("robot", policy=[0], actions={"Go": act}, safe_action=act)
    page = " ".join((ROOT / "docs" / "safety.md").read_text(encoding="utf-8").split())
    assert "by default 5 + 2 \N{MULTIPLICATION SIGN} (10 + 5) = 35 s" in page
    assert below.patience == 35 + 0.5  # half a second for what the loop takes
