"""A model as the world of an ensemble."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_mdp

from mdm import (
    Ensemble,
    PredicateManager,
    StateFactor,
    World,
    simulate,
)
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.testing import capture_decisions, run_virtual


def test_a_world_sets_predicates_and_takes_its_time():
    model, _ = random_mdp(1, states=4)

    async def main(runtime):
        manager = PredicateManager()
        for name in ("A", "B"):
            manager.sensor(name)

        named = MDP(
            [model.transition_matrix(a) for a in range(2)],
            model.rewards,
            discount=0.8,
            states=Space([Factor("a", 2), Factor("b", 2)]),
        )
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1, 0, 1]),
            model=named,
            actions={0: lambda: None, 1: lambda: None},
            predicates=manager,
            states=[StateFactor("a", ["A"]), StateFactor("b", ["B"])],
        )
        world = World(robot, seed=4, period=0.5)
        await runtime.start(manager)
        await runtime.start(world)
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            for _ in range(20):
                await runtime.clock.sleep(0.5)
                values = manager.values()
                assert decisions[-1].state == 2 * values["A"] + values["B"]
        assert [decision.time for decision in decisions] == [index * 500_000_000 for index in range(len(decisions))]
        assert len(decisions) >= 20

    run_virtual(main)


def test_an_episode_in_which_nothing_is_observed_any_more_ends_with_a_fault():
    """Every step is a false negative."""
    told = np.zeros((1, 2, 2, 2))
    told[0, 0] = 1
    model = POMDP([np.eye(2)], told, [[1.0], [1.0]], discount=0.5, event_observations=True)
    model, policy = model.with_false_negatives(0), AlphaVectors([[0.0, 0.0]], [0], 1)
    result = simulate(model, policy, episodes=3, seed=1, steps=5)
    assert result.returns == pytest.approx((2.0, 2.0, 2.0))  # 1 + 0.5 + 0.25 + ..., with no second decision

    async def main(runtime):
        ensemble = Ensemble("robot", policy=policy, model=model, actions={"0": lambda: None})
        faults = []
        runtime.faults.subscribe(faults.append)
        await runtime.start(World(ensemble, seed=1))
        with capture_decisions(runtime) as decisions:
            await runtime.start(ensemble)
            await runtime.clock.sleep(3.5)
        return faults, decisions

    faults, decisions = run_virtual(main)
    assert {fault.kind for fault in faults} == {"no_observation"}
    assert "no observation in 10000 time steps, in state" in faults[0].detail
    assert [decision.cause for decision in decisions] == ["start", "reset", "reset", "reset"]
