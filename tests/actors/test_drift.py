"""The drift monitor: faults about rows that decisions contradict."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from estimated import nothing

import mdm
from mdm import ConfigError, DriftMonitor, Ensemble, World
from mdm.models import MDP, POMDP
from mdm.testing import probe, run_virtual

RIGHT = [[0.9, 0.1], [0.3, 0.7]]
WRONG = [[0.5, 0.5], [0.3, 0.7]]


def mdp(matrix):
    return MDP([matrix], np.zeros((2, 1)), discount=0.9, states=["dry", "wet"], actions=["go"])


def drifts(robot, world, seconds, **options):
    """Return the faults about drift, in a world, in so many seconds."""

    async def main(runtime):
        faults = probe(runtime.faults)
        monitor = DriftMonitor(robot, **options)
        await runtime.start(monitor)
        await runtime.start(World(robot, world, seed=1, period=1.0))
        await runtime.start(robot)
        await asyncio.sleep(seconds)
        return [(fault.source, fault.kind, fault.detail, fault.time) for fault in faults], monitor

    return run_virtual(main)


def ensemble(model, **options):
    return Ensemble("robot", **({"policy": [0, 0], "model": model, "actions": {"go": nothing}} | options))


def test_a_row_that_drifts_is_a_fault_at_the_decision_s_time():
    robot = ensemble(mdp(RIGHT), drive=1.0)
    ((source, kind, detail, time),), monitor = drifts(robot, mdp(WRONG), 400)
    assert (source, kind) == ("drift", "drift")
    assert detail.startswith("robot: from 'dry' by 'go' to 'dry' in ")
    assert "expected in 90.0%; the odds against the model are " in detail
    assert time % 1_000_000_000 == 0
    assert monitor.test.odds(0, 0) > 1e6


def test_a_model_that_is_right_is_no_fault():
    found, monitor = drifts(ensemble(mdp(RIGHT), drive=1.0), mdp(RIGHT), 2_000)
    assert found == []
    assert 0 < monitor.test.odds(0, 0) < 1_000


def test_something_impossible_is_a_fault_of_its_own_sentence():
    robot = ensemble(mdp([[1, 0], [0, 1]]), drive=1.0)
    (first, *_), _ = drifts(robot, mdp(RIGHT), 50)
    assert first[2] == "robot: from 'dry' by 'go' to 'wet' is impossible by the model, and has happened"


def test_decisions_on_changes_of_the_state_are_jumps():
    """Nothing follows itself there, which is no drift."""
    found, monitor = drifts(ensemble(mdp([[0.9, 0.1], [0.3, 0.7]])), mdp(RIGHT), 2_000)
    assert found == []
    assert monitor.test.odds(0, 0) == 1  # where there is no choice there is no bet


def hearing(right):
    return POMDP(
        [np.eye(2)] * 2,
        [[[right, 1 - right], [1 - right, right]]] * 2,
        np.zeros((2, 2)),
        discount=0.9,
        states=["left", "right"],
        actions=["listen", "look"],
        observation_names=["l", "r"],
    )


def test_observations_drift_as_the_belief_predicts_them():
    model = hearing(0.9)
    policy = mdm.policies.AlphaVectors([[0.0, 0.0], [-1.0, -1.0]], [0, 1])
    robot = ensemble(model, policy=policy, actions={"listen": nothing, "look": nothing})
    (first,), _ = drifts(robot, hearing(0.7), 400)
    assert first[2].startswith("robot: after 'listen': ")
    robot = ensemble(model, policy=policy, actions={"listen": nothing, "look": nothing})
    assert drifts(robot, hearing(0.9), 1_000)[0] == []


def test_what_other_ensembles_decide_is_not_looked_at():
    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(DriftMonitor(ensemble(mdp([[1, 0], [0, 1]]))))
        other = Ensemble("other", policy=[0, 0], model=mdp(RIGHT), actions={"go": nothing})
        await runtime.start(World(other, seed=1, period=1.0))
        await runtime.start(other)
        await asyncio.sleep(50)
        return faults

    assert run_virtual(main) == []


def test_beliefs_from_outside_are_said_not_to_be_watched():
    model = hearing(0.9)
    options = {"policy": mdm.policies.AlphaVectors([[0.0, 0.0], [-1.0, -1.0]], [0, 1])}
    robot = ensemble(model, actions={"listen": nothing, "look": nothing}, **options)

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(DriftMonitor(robot))
        await runtime.start(robot)
        for _ in range(3):
            robot.publish_belief([0.5, 0.5])
            await asyncio.sleep(1)
        return faults

    (fault,) = run_virtual(main)
    assert (fault.kind, fault.detail) == ("unwatched", "robot decides on beliefs from outside")


def test_a_monitor_needs_a_model_whose_steps_are_known_and_odds():
    with pytest.raises(ConfigError, match="ensemble 'robot' has none: give it one"):
        DriftMonitor(Ensemble("robot", policy=[0, 0], actions={"go": nothing}))
    with pytest.raises(ConfigError, match="the odds of an alarm are more than 1"):
        DriftMonitor(ensemble(mdp(RIGHT)), odds=0.1)
    waiting = hearing(0.9).with_false_negatives("l")
    options = {
        "policy": mdm.policies.AlphaVectors([[0.0, 0.0], [-1.0, -1.0]], [0, 1]),
        "actions": {"listen": nothing, "look": nothing},
    }
    with pytest.raises(ConfigError, match="may go on without a detection"):
        DriftMonitor(ensemble(waiting, **options))
    assert DriftMonitor(ensemble(waiting, drive=1.0, **options)).name == "drift"
