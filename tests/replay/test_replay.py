"""Replays: the first decision that differs is found, and nothing before it."""

from __future__ import annotations

import asyncio
import random
import time

import numpy as np
import pytest
from msgspec.structs import replace
from records import Writing, with_gap
from sentences import refused

import mdm
from mdm.actors import AbandonedError
from mdm.errors import Error
from mdm.messages import Decision, SensorUpdate
from mdm.recording import Record
from mdm.replay import replay
from mdm.stimuli import Said, Stimulus
from mdm.testing import capture_decisions, crash, run_virtual

pytestmark = pytest.mark.usefixtures("recorded_here")

_POLICY = [0, 1, 2, 0, 1, 2, 0, 1]


class Robot:
    """An ensemble over eight states, by a table."""

    def __init__(self, policy=_POLICY, right=asyncio.sleep):
        self.predicates = mdm.PredicateManager("predicates")
        self.sensors = [self.predicates.sensor(name, initial=False) for name in "ABC"]
        self.ensemble = mdm.Ensemble(
            "robot",
            policy=mdm.policies.DeterministicPolicy(policy, 3),
            predicates=self.predicates,
            states=[mdm.StateFactor(name.lower(), [name]) for name in "ABC"],
            actions={"left": lambda: None, "right": right, "stay": lambda: None},
        )


def walk(path, seed=0, count=60):
    """Record a robot whose sensors change at random; return what it decides."""
    draw = random.Random(seed)
    robot = Robot()

    async def main(runtime):
        decisions = []
        runtime.decisions.subscribe(decisions.append)
        await runtime.start(robot.ensemble)
        for _ in range(count):
            await asyncio.sleep(draw.choice([0.01, 0.1]))
            draw.choice(robot.sensors).set(draw.random() < 0.5)
        return decisions

    return run_virtual(main, record=path)


def without(path, new, left_out):
    """Write a record once more without one of its messages of input; return the new record."""
    record = Record(path)
    writing = Writing(new, record.head)
    kinds = {"stimuli": Stimulus, "decisions": Decision}
    for each in record.messages(["stimuli", "decisions"]):
        if each.message != left_out:
            writing.write(each.topic, each.message, kinds[each.topic])
            writing.writer.flush()
    return Record(writing.close())


def test_a_run_in_virtual_time_is_repeated(tmp_path):
    decisions = walk(tmp_path / "run.mcap")
    result = replay(tmp_path / "run.mcap", Robot().ensemble)
    assert result.same
    assert result.exact
    assert result.lost == 0
    assert result.recorded == result.replayed == len(decisions) > 20


@pytest.mark.parametrize("error", [Error, AbandonedError])
def test_an_action_that_may_go_on_is_abandoned_in_a_replay_as_well(tmp_path, error):
    async def go():
        try:
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            await asyncio.sleep(0.5)
            raise error("the base does not answer") from None

    def robot():
        return mdm.Ensemble("robot", policy=[0, 1], actions={0: lambda: None, 1: go}, safe_action=lambda: None)

    async def main(runtime):
        ensemble, decisions = robot(), []
        runtime.decisions.subscribe(decisions.append)
        await runtime.start(ensemble)
        for state in (1, 0, 1):
            ensemble.publish_state(state)
            await asyncio.sleep(1)
        return [decision.cause for decision in decisions]

    causes = run_virtual(main, record=tmp_path / "run.mcap")
    assert ("release" in causes) is (error is AbandonedError)
    assert replay(tmp_path / "run.mcap", robot()).same


@pytest.mark.parametrize("count", [1, 2, 7])
def test_behind_a_gap_nothing_is_compared_and_nothing_differs_falsely(tmp_path, count):
    walk(tmp_path / "run.mcap")
    whole = [*Record(tmp_path / "run.mcap").messages()]
    for first in range(12 + count, len(whole) - count, 29):
        record = with_gap(tmp_path / "run.mcap", tmp_path / "gap.mcap", first, count)
        before = [each for each in whole[:first] if each.topic == "decisions"]
        result = replay(record, Robot().ensemble)
        assert result.same
        assert (result.recorded, result.replayed, result.lost) == (len(before), len(before), count)
        assert result.gap == (first - 1, whole[first - 1].time, whole[first + count].time)
        other = replay(record, Robot(policy=[1, 0, 2, 0, 1, 2, 0, 1]).ensemble)
        assert all(each.recorded in [one.message for one in before] for each in other.differences)


def test_a_record_without_its_first_messages_is_refused(tmp_path):
    walk(tmp_path / "run.mcap")
    record = with_gap(tmp_path / "run.mcap", tmp_path / "gap.mcap", 0, 3)
    with refused(Error):
        replay(record, Robot().ensemble)


class Watcher(mdm.Actor):
    """Looks at a predicate ten times a second, and says nothing."""

    def __init__(self, robot):
        super().__init__("watcher")
        self.robot, self.seen = robot, []

    def on_start(self):
        self.every(10.0, lambda _: self.seen.append(self.robot.sensors[0].value))


class Teller(mdm.Actor):
    """Tells the predicate otherwise at each of these ticks, behind the watcher."""

    def __init__(self, robot):
        super().__init__("teller")
        self.robot = robot

    def on_start(self):
        self.every(10.0, lambda tick: self.robot.sensors[0].set(tick.number % 2 == 0))


def test_what_is_said_at_one_of_several_ticks_of_one_time_is_not_said_at_another(tmp_path):
    def actors():
        robot = Robot()
        return robot.ensemble, Watcher(robot), Teller(robot)

    async def main(runtime, *actors):
        for each in actors:
            await runtime.start(each)
        await asyncio.sleep(2.05)

    run, again = actors(), actors()
    run_virtual(lambda runtime: main(runtime, *run), record=tmp_path / "run.mcap")
    assert replay(tmp_path / "run.mcap", again).same
    assert again[1].seen == run[1].seen
    assert {True, False} <= set(run[1].seen)


@pytest.mark.parametrize("entry", range(8))
def test_another_entry_of_a_policy_is_found_where_it_first_decides(tmp_path, entry):
    decisions = walk(tmp_path / "run.mcap", seed=entry)
    policy = list(_POLICY)
    policy[entry] = (policy[entry] + 1) % 3
    result = replay(tmp_path / "run.mcap", Robot(policy).ensemble)
    expected = [number for number, decision in enumerate(decisions) if decision.state == entry]
    assert [difference.number for difference in result.differences] == expected
    assert all(difference.fields == ("action",) for difference in result.differences)


def test_a_replay_ends_at_the_last_difference_that_is_kept(tmp_path):
    walk(tmp_path / "run.mcap")
    result = replay(tmp_path / "run.mcap", Robot([2, 0, 1, 2, 0, 1, 2, 0]).ensemble, most=3)
    assert [difference.number for difference in result.differences] == [0, 1, 2]
    assert result.replayed == 3


def test_a_message_of_a_sensor_that_is_missing_is_found_at_the_decision_on_it(tmp_path):
    decisions = walk(tmp_path / "run.mcap")
    said = {
        each.message.time: each.message
        for each in Record(tmp_path / "run.mcap").messages(["stimuli"])
        if isinstance(each.message, Said) and each.message.type == SensorUpdate.__name__
    }
    for number, decision in list(enumerate(decisions))[1:20:4]:
        record = without(tmp_path / "run.mcap", tmp_path / f"{number}.mcap", said[decision.time])
        (difference,) = replay(record, Robot().ensemble, most=1).differences
        assert difference.number == number
        assert difference.recorded.time == decision.time


# -- Beliefs -----------------------------------------------------------------------------------------------------------

_HEARING = np.array([[0.85, 0.15], [0.15, 0.85]])


def tiger(hearing):
    """Return an ensemble that listens for a tiger, whose ears are so good."""
    model = mdm.models.POMDP([np.eye(2)] * 2, [hearing] * 2, np.zeros((2, 2)), discount=0.9, actions=["listen", "open"])
    vectors = np.array([[1.0, 1.0], [0.0, 1.05]])
    return mdm.Ensemble(
        "tiger",
        model=model,
        policy=mdm.policies.AlphaVectors(vectors, [0, 1], 2),
        actions={"listen": lambda: None, "open": lambda: None},
    )


def heard(path, symbols):
    """Record what is decided on what is heard."""
    ensemble = tiger(_HEARING)

    async def main(runtime):
        await runtime.start(ensemble)
        for symbol in symbols:
            await asyncio.sleep(0.5)
            ensemble.publish_observation(symbol)

    run_virtual(main, record=path)


def beliefs(symbols, hearing):
    """Return the belief before each observation and after the last, by Bayes' rule."""
    found = [np.array([0.5, 0.5])]
    for symbol in symbols:
        belief = found[-1] * hearing[:, symbol]
        found.append(belief / belief.sum())
    return found


@pytest.mark.parametrize("symbols", [[1, 1, 0, 1, 0, 1], [0, 1, 1], [1, 1, 1, 1, 1, 0]])
def test_another_entry_of_a_model_is_found_where_the_belief_parts(tmp_path, symbols):
    heard(tmp_path / "run.mcap", symbols)
    assert replay(tmp_path / "run.mcap", tiger(_HEARING)).same
    other = np.array([[0.85, 0.15], [0.25, 0.75]])
    (difference,) = replay(tmp_path / "run.mcap", tiger(other), most=1).differences
    before, now = beliefs(symbols, _HEARING), beliefs(symbols, other)
    parts = next(n for n, (one, another) in enumerate(zip(before, now, strict=True)) if not np.allclose(one, another))
    assert difference.number == parts
    assert "belief" in difference.fields
    np.testing.assert_allclose(difference.recorded.belief, before[parts])
    np.testing.assert_allclose(difference.replayed.belief, now[parts])


# -- Starts and ends ---------------------------------------------------------------------------------------------------


def told():
    """Return an ensemble that is told its states, and starts anew when it has failed."""
    return mdm.Ensemble(
        "told",
        policy=[0, 1, 0, 1],
        actions={"left": lambda: None, "right": lambda: None},
        supervision=mdm.Restart(limit=50, backoff=0.01),
    )


def test_a_state_that_is_told_before_a_restart_is_decided_on_behind_it(tmp_path):
    ensemble = told()

    async def main(runtime):
        await runtime.start(ensemble)
        ensemble.publish_state(1)
        await asyncio.sleep(0.1)
        crash(ensemble)
        ensemble.publish_state(2)  # from before the end: forgotten
        while ensemble.life != "restarting":
            await asyncio.sleep(0)
        ensemble.publish_state(3)
        await asyncio.sleep(0.1)

    run_virtual(main, record=tmp_path / "run.mcap")
    decisions = [each.message for each in Record(tmp_path / "run.mcap").messages(["decisions"])]
    assert [(decision.state, decision.cause) for decision in decisions] == [(1, "state"), (3, "start")]
    assert replay(tmp_path / "run.mcap", told()).same


def test_an_ensemble_that_the_program_stops_and_starts_again_is_repeated(tmp_path):
    robot = Robot(right=lambda: None)

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            for value in (True, False):
                await runtime.start(robot.ensemble)
                for sensor in robot.sensors:
                    sensor.set(value)
                await asyncio.sleep(1)
                await runtime.stop(robot.ensemble)
                robot.sensors[0].set(value)
                await asyncio.sleep(1)
        return decisions

    decisions = run_virtual(main, record=tmp_path / "run.mcap")
    result = replay(tmp_path / "run.mcap", Robot(right=lambda: None).ensemble)
    assert (result.differences, result.replayed) == ((), len(decisions))
    assert {round(each.time / 1e9) for each in decisions} == {0, 2}


def test_a_decision_behind_the_end_of_the_run_is_not_missed_whatever_its_time(tmp_path):
    made = walk(tmp_path / "run.mcap")
    record = Record(tmp_path / "run.mcap")
    writing = Writing(tmp_path / "late.mcap", record.head)
    kinds = {"stimuli": Stimulus, "decisions": Decision}
    for each in record.messages(["stimuli", "decisions"]):
        writing.write(each.topic, each.message, kinds[each.topic])
        writing.writer.flush()
    last = made[-1]
    writing.write("decisions", replace(last, epoch=last.epoch + 1), Decision)  # stamped before the end
    result = replay(Record(writing.close()), Robot().ensemble)
    assert (result.differences, result.recorded) == ((), len(made))


@pytest.mark.parametrize("drive", ["event", 10.0, 20.0])
def test_ticks_at_other_times_cannot_be_told(tmp_path, drive):
    def ticking(drive):
        return mdm.Ensemble("robot", policy=[0], actions={"stay": lambda: None}, drive=drive)

    async def main(runtime):
        robot = ticking(drive)
        await runtime.start(robot)
        robot.publish_state(0)
        await asyncio.sleep(1)

    run_virtual(main, record=tmp_path / "run.mcap")
    assert replay(tmp_path / "run.mcap", ticking(drive)).same
    with refused(Error):
        replay(tmp_path / "run.mcap", ticking(5.0))
    if drive != "event":  # without ticks it decides on what comes
        assert replay(tmp_path / "run.mcap", ticking("event")).replayed == 1


def test_a_record_without_a_start_is_refused(tmp_path):
    walk(tmp_path / "run.mcap", count=2)
    record = Record(tmp_path / "run.mcap")
    writing = Writing(tmp_path / "other.mcap", record.head)
    for each in record.messages(["decisions"]):
        writing.write("decisions", each.message)
    writing.close()
    with refused(Error):
        replay(tmp_path / "other.mcap", Robot().ensemble)


def resetting(*, holds):
    """Return a robot whose first action resets it, and then holds the event loop beyond its deadline."""
    calls = []

    def act():
        calls.append(None)
        if holds and len(calls) == 1:
            robot.reset()
            time.sleep(0.1)

    model = mdm.problems.tiger()
    robot = mdm.Ensemble(
        "tiger",
        policy=mdm.policies.AlphaVectors([[-2.0, -2.0], [-50.0, 20.0], [20.0, -50.0]], [0, 1, 2], 3),
        model=model,
        actions=dict.fromkeys(model.action_space.names, act),
        deadline=0.05,
        safe_action=lambda: None,
    )
    return robot


def test_of_two_decisions_of_one_epoch_and_time_the_one_that_was_late_is_late(tmp_path):
    path = tmp_path / "run.mcap"

    async def main():
        async with mdm.Runtime(log=False, watchdog=None, record=path) as runtime:
            await runtime.start(resetting(holds=True))

    mdm.run(main)
    recorded = [each.message for each in Record(path).messages(["stimuli"])]
    assert [type(each).__name__ for each in recorded].count("Late") >= 1
    assert replay(path, [resetting(holds=False)]).differences == ()
