"""The way back from safe modes: what the belief then is, releases, restarts and fresh input."""

from __future__ import annotations

import asyncio
from functools import partial

import numpy as np
import pytest
from safe_robots import Log, robot, sensed

from mdm import Ensemble, PredicateManager, Restart, StateFactor, VirtualClock
from mdm.messages import Control, Mode
from mdm.models import POMDP
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.runtime import ActorFailure
from mdm.testing import capture_decisions, crash, probe, run_virtual

# -- Deadlines and beliefs -----------------------------------------------------------------------------------------


class Behind(VirtualClock):
    """A clock that a slow policy moves on."""

    behind = 0

    def now(self):
        return super().now() + self.behind


class Slow(AlphaVectors):
    """Takes 0.2 s for the decisions whose numbers are given."""

    clock = None
    late = ()
    count = 0

    def action(self, belief):
        if self.count in self.late:
            self.clock.behind += 200_000_000
        self.count += 1
        return self.count - 1 if self.count < 3 else 2


def moving(actions=3):
    """Up to three actions that move the belief each in its own way."""
    stay, half, flip = np.eye(2), np.full((2, 2), 0.5), np.array([[0.0, 1.0], [1.0, 0.0]])
    blind = np.ones((2, 1))
    moves, rewards = [stay, half, flip][:actions], np.zeros((2, actions))
    return POMDP(moves, [blind] * actions, rewards, discount=0.9, initial_belief=[0.9, 0.1])


@pytest.mark.parametrize(
    ("safe", "after", "belief"),
    [
        ("2", "reset", [0.1, 0.9]),  # one of the model's: the belief goes by it
        (None, "keep", [0.9, 0.1]),  # else by what was done before the late decision
        (None, "reset", [0.9, 0.1]),  # or it starts anew
    ],
)
def test_a_late_decision_does_not_move_the_belief_by_what_was_not_done(safe, after, belief):
    log = Log()

    async def main(runtime):
        policy = Slow([[0.0, 0.0]], [0], 3)
        policy.clock, policy.late = runtime.clock, (1,)
        one = robot(
            log,
            policy=policy,
            model=moving(),
            actions={str(index): log.plain(str(index)) for index in range(3)},
            safe_action=log.plain("SAFE") if safe is None else safe,
            deadline=0.1,
            after_safe=after,
        )
        await runtime.start(one)
        with capture_decisions(runtime) as decisions:
            one.publish_observation(0)
            assert log == ["0", "SAFE" if safe is None else "2"]
            assert decisions == []
            assert one.mode == "safe"
            one.publish_observation(0)
            assert one.mode == "deciding"
        assert decisions[0].belief == pytest.approx(belief)
        assert decisions[0].epoch == (0 if safe is None and after == "reset" else 2)

    run_virtual(main, clock=Behind())


@pytest.mark.parametrize(("held", "late"), [(0.25, False), (0.5, True)])
def test_a_callback_that_holds_the_loop_beyond_the_deadline_of_ticks_makes_safe(held, late):
    log = Log()

    async def main(runtime):
        def hold():
            log.append("A")
            if len(log) == 3:
                asyncio.get_running_loop()._virtual.now += round(held * 1e9)

        one = robot(log, actions={"A": hold, "B": log.plain("B")}, drive=10.0, deadline=0.2)
        faults = probe(runtime.faults)
        await runtime.start(one)
        one.publish_state(0)
        await asyncio.sleep(2)
        assert one.mode == "deciding"  # the tick after it was in time
        assert one.control.ticks.missed > 0
        assert log.count("SAFE") == late
        assert [fault.kind for fault in faults] == ["deadline"] * late

    run_virtual(main)


# -- Release -------------------------------------------------------------------------------------------------------


def test_release_waits_for_the_safe_action_and_no_longer():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=log.slow("SAFE", 3.0), on_unknown="continue")
        told = probe(runtime.channel("robot/mode", Mode, retain=True))
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        one.release()
        assert one.mode == "safe"
        await asyncio.sleep(3)
        assert one.mode == "deciding"
        assert [(mode.mode, [cause.kind for cause in mode.causes], mode.time) for mode in told] == [
            ("deciding", [], 0),
            ("safe", ["stale_input"], 10**9),
            ("safe", [], 2 * 10**9),
            ("deciding", [], 4 * 10**9),
        ]
        late = probe(runtime.channel("robot/mode", Mode, retain=True))
        assert [mode.mode for mode in late] == ["deciding"]

    run_virtual(main)


@pytest.mark.parametrize("who", ["subscriber", "safe action"])
def test_a_release_at_once_decides_on_nothing_old(who):
    log = Log()

    async def main(runtime):
        def safe():
            log.append("SAFE")
            if who == "safe action":
                one.release()

        one, _, sensor = sensed(log, max_age=1.0, safe_action=safe)
        if who == "subscriber":
            runtime.faults.subscribe(lambda fault: one.release() if fault.kind == "stale_input" else None)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1.5)
        assert log == ["A", "SAFE"]
        sensor.set(True)
        assert log == ["A", "SAFE", "B"]

    run_virtual(main)


def test_release_by_a_message():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        assert one.mode == "safe"
        runtime.channel("robot/control", Control).publish(Control(runtime.clock.now(), "release"))
        assert (one.mode, one.causes) == ("deciding", ())

    run_virtual(main)


@pytest.mark.parametrize("policy", ["states", "beliefs"])
def test_a_policy_that_can_choose_nothing_is_safe_until_the_next_input(policy):
    log, chosen = Log(), [0, -1, 1]

    class Choosing(DeterministicPolicy if policy == "states" else AlphaVectors):
        table = None  # ask it each time

        def action(self, _):
            return chosen.pop(0)

    async def main(runtime):
        given = Choosing([0, 0], 2) if policy == "states" else Choosing([[0.0, 0.0]], [0], 2)
        model = None if policy == "states" else moving(2)
        one = robot(log, policy=given, model=model, actions={"0": log.plain("A"), "1": log.plain("B")})
        await runtime.start(one)
        tell = one.publish_state if policy == "states" else one.publish_observation
        if policy == "states":
            tell(0)
        assert log == ["A"]
        tell(0)
        assert log == ["A", "SAFE"]  # not the last action, of which -1 might be an index
        assert [cause.kind for cause in one.causes] == ["state" if policy == "states" else "policy"]
        tell(0)
        assert (log, one.mode) == (["A", "SAFE", "B"], "deciding")

    run_virtual(main)


@pytest.mark.parametrize("policy", ["states", "beliefs"])
def test_an_error_in_a_policy_s_code_is_safe_until_the_next_input_and_else_a_failure(policy):
    log = Log()

    class Raising(DeterministicPolicy if policy == "states" else AlphaVectors):
        table = None  # ask it each time

        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.calls = 0

        def action(self, _):
            self.calls += 1
            return {}["gone"] if self.calls == 2 else 1

    async def main(runtime, *, safe):
        given = Raising([0, 0], 2) if policy == "states" else Raising([[0.0, 0.0]], [0], 2)
        model = None if policy == "states" else moving(2)
        options = {} if safe else {"safe_action": None}
        one = robot(log, policy=given, model=model, actions={"0": log.plain("A"), "1": log.plain("B")}, **options)
        faults = probe(runtime.faults)
        await runtime.start(one)
        tell = one.publish_state if policy == "states" else one.publish_observation
        if policy == "states":
            tell(0)
        tell(0)
        if not safe:
            await asyncio.sleep(1)
            raise AssertionError(one.mode)
        assert log == ["B", "SAFE"]
        assert [(cause.kind, cause.detail) for cause in one.causes] == [("policy", faults[0].detail)]
        assert "Raising has raised KeyError: 'gone' (at " in faults[0].detail
        assert "test_way_back.py:" in faults[0].detail
        tell(0)
        assert (log, one.mode) == (["B", "SAFE", "B"], "deciding")

    run_virtual(partial(main, safe=True))
    with pytest.raises(ActorFailure, match="KeyError"):
        run_virtual(partial(main, safe=False))


def test_a_stop_lets_the_safe_action_end_and_a_start_begins_anew():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=log.slow("SAFE", 3.0))
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1.5)
        one.stop()
        idle = []
        one.when_idle(lambda: idle.append(runtime.clock.now()))
        await asyncio.sleep(5)
        assert (one.mode, idle, log[-1]) == ("stopped", [4 * 10**9], "SAFE ends")
        sensor.set(True)
        assert log[-1] == "SAFE ends"
        one.start()
        assert log[-1] == "B"

    run_virtual(main)


# -- Restarts and fresh input --------------------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [True, False])
def test_after_a_restart_nothing_old_is_decided_on(shared):
    log = Log()

    async def main(runtime):
        one, manager, sensor = sensed(log, max_age=0.5, supervision=Restart(backoff=1.0))
        if shared:
            await runtime.start(manager)
        await runtime.start(one)
        sensor.set(False)
        crash(one.state)
        await asyncio.sleep(3)
        assert one.life == "running"
        assert log == ["A", "SAFE"]
        sensor.set(True)
        assert log == ["A", "SAFE", "B"]

    run_virtual(main)


def test_initial_values_do_not_come_back_and_what_sensors_are_told_meanwhile_does():
    log = Log()

    async def main(runtime):
        manager = PredicateManager()
        first = manager.sensor("P", initial=False)
        second = manager.sensor("Q", initial=False)
        one = robot(
            log,
            policy=DeterministicPolicy([0, 1, 1, 1]),
            predicates=manager,
            states=[StateFactor("p", ["P"]), StateFactor("q", ["Q"])],
            supervision=Restart(backoff=1.0),
        )
        await runtime.start(one)
        assert log == ["A"]
        crash(one.state)
        await asyncio.sleep(0.5)
        first.set(True)
        await asyncio.sleep(2)
        assert manager.values() == {"P": True, "Q": None}
        assert log == ["A", "SAFE"]
        second.set(False)
        assert log == ["A", "SAFE", "B"]

    run_virtual(main)


@pytest.mark.parametrize("failing", ["manager", "layer"])
@pytest.mark.parametrize("pause", [None, 0.0, 1.0, 2.5])
def test_what_sensors_are_told_from_the_failure_on_counts(failing, pause):
    """At once, in the next turn, while the safe action still runs, and in the back-off."""
    log = Log()

    async def main(runtime):
        one, manager, sensor = sensed(log, safe_action=log.slow("SAFE", 2.0), supervision=Restart(backoff=1.0))
        await runtime.start(one)
        sensor.set(False)
        crash(manager if failing == "manager" else one.state)
        if pause is not None:
            await asyncio.sleep(pause)
        sensor.set(True)
        await asyncio.sleep(4)
        assert log == ["A", "SAFE begins", "SAFE ends", "B"]

    run_virtual(main)


def test_what_a_sensor_was_told_in_a_back_off_grows_old_there():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=0.5, supervision=Restart(backoff=1.0))
        await runtime.start(one)
        sensor.set(False)
        crash(one.state)
        await asyncio.sleep(0.1)
        sensor.set(True)  # 0.9 s before the restart
        await asyncio.sleep(2)
        assert (one.life, log) == ("running", ["A", "SAFE"])
        crash(one.state)
        await asyncio.sleep(1.8)
        sensor.set(True)  # 0.2 s before it: the second back-off takes twice as long
        await asyncio.sleep(0.4)
        assert (one.life, log) == ("running", ["A", "SAFE", "SAFE", "B"])
        await asyncio.sleep(0.2)
        assert log == ["A", "SAFE", "SAFE", "B", "SAFE"]

    run_virtual(main)


def test_what_was_told_since_a_failure_is_forgotten_where_the_manager_lives_on():
    log = Log()

    async def main(runtime):
        one, manager, sensor = sensed(log, supervision="stop")
        other = robot(log, name="other", predicates=manager, states=[StateFactor("s", ["S"])])
        await runtime.start(one)
        await runtime.start(other)
        crash(one.state)
        sensor.set(True)
        await asyncio.sleep(1)
        await runtime.stop(other)
        log.clear()
        await runtime.start(other)
        await asyncio.sleep(1)
        assert (log, manager.values()) == ([], {"S": None})

    run_virtual(main)


@pytest.mark.parametrize("commands", [["stop"], ["start", "stop"], ["stop", "start"]])
@pytest.mark.parametrize("pause", [0.0, 1.0, 2.5])
def test_what_an_ensemble_is_told_between_a_failure_and_its_restart_holds_then(commands, pause):
    """In the turn of the failure, while the safe action still runs, and in the back-off."""
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, safe_action=log.slow("SAFE", 2.0), supervision=Restart(backoff=1.0))
        await runtime.start(one)
        sensor.set(False)
        crash(one.state)
        if pause:
            await asyncio.sleep(pause)
        for command in commands:
            getattr(one, command)()
        sensor.set(True)
        await asyncio.sleep(4)
        stopped = commands[-1] == "stop"
        assert (one.life, one.mode) == ("running", "stopped" if stopped else "deciding")
        assert log == ["A", "SAFE begins", "SAFE ends", *([] if stopped else ["B"])]
        crash(one.state)
        await asyncio.sleep(5)
        assert one.mode == "deciding"  # it holds for one start alone

    run_virtual(main)


@pytest.mark.parametrize("supervision", ["stop", Restart(backoff=1.0)])
def test_what_an_ensemble_is_told_that_fails_for_good_does_not_hold_for_a_start_by_hand(supervision):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, safe_action=log.slow("SAFE", 2.0), supervision=supervision)
        await runtime.start(one)
        sensor.set(False)
        crash(one.state)
        one.stop()
        await asyncio.sleep(0.1)
        await runtime.stop(one)
        await runtime.start(one)
        assert one.mode == "deciding"

    run_virtual(main)


def test_a_new_ensemble_of_the_same_name_knows_no_old_state():
    log = Log()

    async def main(runtime):
        one = robot(log)
        await runtime.start(one)
        one.publish_state(0)
        await runtime.stop(one)
        log.clear()
        await runtime.start(robot(log))
        await asyncio.sleep(1)
        assert log == []

    run_virtual(main)


@pytest.mark.parametrize("how", ["stop", "above", "failure"])
def test_after_a_safe_action_that_failed_twice_nothing_but_a_release_leads_back(how):
    log = Log()

    def brake():
        log.append("SAFE")
        if len(log) < 4:
            raise LookupError

    async def main(runtime):
        one, _, sensor = sensed(log, safe_action=brake, supervision=Restart())
        top = Ensemble("top", policy=[0, 1], actions={"Rest": log.plain("Rest"), "Below": one})
        await runtime.start(top)
        top.publish_state(1)
        sensor.set(False)
        sensor.set(None)
        sensor.set(False)
        assert log == ["A", "SAFE", "SAFE"]
        assert [cause.kind for cause in one.causes] == ["safe_action"]
        if how == "stop":
            one.stop()
            assert (one.mode, [cause.kind for cause in one.causes]) == ("stopped", ["safe_action"])
            one.start()
        elif how == "above":
            top.publish_state(0)
            top.publish_state(1)
        else:
            crash(one.control)
            await asyncio.sleep(5)
            top.publish_state(0)
            top.publish_state(1)
            sensor.set(False)
        assert (one.mode, [cause.kind for cause in one.causes]) == ("safe", ["safe_action"])
        assert log[-1] == "SAFE"
        one.release()
        assert (one.mode, one.causes, log[-1]) == ("deciding", (), "A")

    run_virtual(main)


def test_what_is_stopped_can_be_released():
    log = Log()

    def brake():
        raise LookupError

    async def main(runtime):
        one, _, sensor = sensed(log, safe_action=brake)
        await runtime.start(one)
        sensor.set(False)
        sensor.set(None)
        assert [cause.kind for cause in one.causes] == ["unknown_input", "safe_action"]
        one.stop()
        assert [cause.kind for cause in one.causes] == ["safe_action"]
        one.release()
        assert (one.mode, one.causes) == ("stopped", ())
        sensor.set(False)
        one.start()
        assert one.mode == "deciding"

    run_virtual(main)


@pytest.mark.parametrize("gone", [True, False])
def test_a_cause_that_comes_while_it_is_stopped_stands_at_its_start(gone):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log)
        await runtime.start(one)
        sensor.set(False)
        one.stop()
        one.safety.endanger("bumper", "something is in the way", runtime.now())
        assert (one.mode, [cause.kind for cause in one.causes], log) == ("stopped", ["bumper"], ["A"])
        if gone:
            one.safety.reopen(frozenset({"bumper"}), runtime.now())
            assert one.causes == ()
        one.start()
        await asyncio.sleep(1)
        assert (one.mode, log[1:]) == (("deciding", ["A"]) if gone else ("safe", ["SAFE"]))
        one.release()
        assert (one.mode, log[-1]) == ("deciding", "A")

    run_virtual(main)
