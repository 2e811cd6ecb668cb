"""Input that grows old or turns unknown: what it does to the live action, and what is told."""

from __future__ import annotations

import asyncio

import pytest
from safe_robots import Log, certain, robot, sensed

from mdm import ObservationFactor, PredicateManager, StateFactor
from mdm.policies import AlphaVectors
from mdm.testing import probe, run_virtual


def test_a_state_that_turns_unknown_makes_safe_until_it_is_known():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": log.slow("A", 1e6), "B": log.plain("B")})
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1)
        sensor.set(None)
        await asyncio.sleep(1)
        assert log == ["A begins", "A ends", "SAFE"]
        assert [(fault.kind, fault.detail) for fault in faults] == [("unknown_input", "the state turned unknown: S")]
        sensor.set(True)
        assert log[-1] == "B"

    run_virtual(main)


@pytest.mark.parametrize("options", [{"on_unknown": "continue"}, {"safe_action": None}])
def test_with_continue_or_without_a_safe_action_the_old_action_goes_on_and_waiting_is_told(options):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": log.slow("A", 1e6), "B": log.plain("B")}, **options)
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1)
        sensor.set(None)
        await asyncio.sleep(2)
        assert one.action.live == ("A",)
        assert [(fault.kind, fault.detail) for fault in faults] == [("waiting", "cannot decide while S is unknown")]

    run_virtual(main)


def test_a_sensor_of_observations_that_turns_unknown_makes_safe_until_it_is_known():
    log = Log()

    async def main(runtime):
        manager = PredicateManager()
        seen = manager.sensor("Seen")
        manager.event("E0", "Seen")
        manager.event("E1", "not Seen")
        one = robot(
            log,
            policy=AlphaVectors([[0.0, 0.0]], [0], 1),
            model=certain(),
            actions={0: log.slow("A", 1e6)},
            predicates=manager,
            observations=[ObservationFactor("o", ["E0", "E1"])],
        )
        faults = probe(runtime.faults)
        await runtime.start(one)
        await asyncio.sleep(1)
        assert (one.mode, log) == ("deciding", ["A begins"])  # unknown since the start is no loss
        seen.set(True)
        seen.set(None)
        await asyncio.sleep(1)
        assert log == ["A begins", "A ends", "SAFE"]
        assert [(fault.kind, fault.detail) for fault in faults] == [("unknown_input", "input turned unknown: Seen")]
        seen.set(True)
        assert one.mode == "deciding"

    run_virtual(main)


def test_old_input_told_alone_leaves_the_action_alone():
    log = Log()

    async def main(runtime):
        slow = {"A": log.slow("A", 1e6), "B": log.plain("B")}
        one, _, sensor = sensed(log, max_age=1.0, actions=slow, on_lost_input="continue", on_unknown="continue")
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1.5)
        assert (one.mode, one.action.live) == ("deciding", ("A",))
        assert ("stale_input", "input is too old: S") in [(fault.kind, fault.detail) for fault in faults]

    run_virtual(main)


def test_old_input_is_a_cause_of_its_own():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, on_unknown="continue")
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        assert [cause.kind for cause in one.causes] == ["stale_input"]
        sensor.set(True)
        assert (one.mode, log) == ("deciding", ["A", "SAFE", "B"])

    run_virtual(main)


def _either(log, **options):
    """A robot whose state is known while one of two sensors is true, of which the laser grows old after a second."""
    manager = PredicateManager()
    other, laser = manager.sensor("Other", initial=True), manager.sensor("Laser", initial=True, max_age=1.0)
    manager.define("Clear", "Other or Laser")
    return robot(log, predicates=manager, states=[StateFactor("s", ["Clear"])], **options), other, laser


@pytest.mark.parametrize("lost", ["stale_input", "unknown_input"])
def test_input_that_is_lost_while_safe_for_another_cause_is_one_more(lost):
    log = Log()

    def fail():
        log.append("B")
        if len(log) == 1:
            raise LookupError

    async def main(runtime):
        one, other, laser = _either(log, actions={"A": log.plain("A"), "B": fail})
        faults = probe(runtime.faults)
        await runtime.start(one)
        assert [cause.kind for cause in one.causes] == ["action"]
        if lost == "stale_input":
            await asyncio.sleep(2)
        else:
            laser.set(False)
            other.set(None)
        assert [cause.kind for cause in one.causes] == ["action", lost]
        assert lost in [fault.kind for fault in faults]
        if lost == "stale_input":
            other.set(False)
            other.set(True)  # a state anew: the action's failure is past
            assert [cause.kind for cause in one.causes] == [lost]
        assert log == ["B", "SAFE"]
        laser.set(True)
        assert log == ["B", "SAFE", "B"]

    run_virtual(main)


@pytest.mark.parametrize("how", ["release", "continue"])
@pytest.mark.parametrize("then", ["unknown", "false"])
def test_a_loss_that_was_let_pass_hides_no_other(how, then):
    log = Log()

    async def main(runtime):
        options = {"on_lost_input": "continue"} if how == "continue" else {}
        one, other, laser = _either(log, actions={"A": log.plain("A"), "B": log.slow("B", 1e6)}, **options)
        await runtime.start(one)
        await asyncio.sleep(2)
        if how == "release":
            assert [cause.kind for cause in one.causes] == ["stale_input"]
            one.release()
            await asyncio.sleep(1)
        assert (one.mode, one.action.live) == ("deciding", ("B",))
        other.set(None if then == "unknown" else False)
        await asyncio.sleep(1)
        if (how, then) == ("continue", "false"):  # unknown by nothing but its age, which is to be let pass
            assert (one.mode, one.action.live) == ("deciding", ("B",))
        else:
            cause = "unknown_input" if then == "unknown" else "stale_input"
            assert (one.mode, [cause.kind for cause in one.causes], log[-1]) == ("safe", [cause], "SAFE")
            laser.set(True)
            await asyncio.sleep(0.5)
            assert one.mode == "deciding"

    run_virtual(main)
