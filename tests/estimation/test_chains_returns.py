"""Returns of episodes."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import decision, lived, visits

import mdm
from mdm.estimation import chains_of, returns_of
from mdm.models import MDP

MODEL = MDP([np.full((3, 3), 1 / 3)] * 2, [[1, 10], [2, 20], [3, 30]], discount=0.5)


def test_rewards_of_decisions_are_discounted_and_those_that_lack_are_the_model_s():
    told = visits([0, 1, 2], actions=[0, 1, 0])
    told[2] = decision(2, 2, "state", 2, 0, reward=100.0)
    told += [decision(3, 0, "episode", 2, 1), decision(4, 1, "state", 0, 0)]
    assert returns_of(MODEL, chains_of(told).chains) == (1 + 0.5 * 20 + 0.25 * 100, 30 + 0.5 * 1)


def test_an_episode_goes_on_across_a_tick_that_was_missed():
    told = visits([0, 0, 0, 0], cause="tick", first="tick", times=[0, 1, 2, 4])
    chains = chains_of(told)
    assert len(chains.chains) == 2
    assert returns_of(MODEL, chains.chains) == (1.875,)


def test_time_may_count_in_place_of_decisions():
    told = visits([0, 0], times=[0, 3])
    told[1] = decision(3, 1, "again", 0, 1)
    assert returns_of(MODEL, chains_of(told).chains, in_time=True) == (1 + 0.125 * 10,)


def test_a_belief_earns_its_expectation():
    told = [decision(0, 0, "start", belief=np.array([0.5, 0.5, 0.0]), action=1)]
    assert returns_of(MODEL, chains_of(told).chains) == (15.0,)


def test_the_returns_are_those_that_a_simulated_world_tells():
    model = mdm.problems.forest()
    finished = []
    world = {"period": 1.0, "finished": finished.append}
    told = lived(model, mdm.solve(model).policy, 60, world=world, horizon=12)
    found = returns_of(model, chains_of(told).chains)
    assert len(finished) >= 4
    assert found[: len(finished)] == pytest.approx(finished)
