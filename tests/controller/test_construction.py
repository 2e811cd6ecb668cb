"""Construction: what a controller takes from its options. What fits no policy is refused: see test_controller."""

from __future__ import annotations

import numpy as np
import pytest

import mdm
from mdm.controller import Controller
from mdm.controller.construction import horizon_of, reward_rows, seeded, with_false_negatives
from mdm.policies import RandomPolicy, StagedPolicy
from mdm.problems import tiger
from mdm.symbols import Symbols


def test_a_horizon_is_at_most_the_policy_s_stages():
    information = StagedPolicy(np.zeros((3, 2, 3))).information(tiger())
    assert [horizon_of(information, given) for given in (None, 1, 3)] == [3, 1, 3]
    with pytest.raises(mdm.ConfigError, match="at most 3 decisions, not of 4"):
        horizon_of(information, 4)


def test_rewards_are_rows_by_action_of_what_is_given_or_else_of_the_model():
    model = tiger()
    symbols = Symbols(RandomPolicy(3, 2, input="state"), model, None)
    given = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(reward_rows(given, model, symbols), given.T)
    np.testing.assert_array_equal(reward_rows(None, model, symbols), model.rewards.T)
    assert reward_rows(None, None, symbols) is None
    given[1, 2] = np.inf
    for wrong, words in (
        (given, "the reward of action 2 in state 1 is inf"),
        ([1.0, 2.0], r"not of shape \(2,\)"),
        ([[1.0], [2.0]], "for 2 states and 1 actions, but the policy is for 2 and 3"),
    ):
        with pytest.raises(mdm.ConfigError, match=words) as caught:
            reward_rows(wrong, model, symbols)
        assert caught.value.key == "rewards"


def test_a_seed_leaves_the_policy_that_was_given_as_it_is():
    given = RandomPolicy(50, 2, input="state")
    one, other = seeded(given, 3), seeded(given, 3)
    assert one is not given
    assert [one.action(0) for _ in range(9)] == [other.action(0) for _ in range(9)]


def test_false_negatives_are_the_model_s():
    model = with_false_negatives(tiger(), "hear-left")
    assert model is not None
    assert Controller(mdm.policies.AlphaVectors([[0.0, 0.0]], [0], 3), model).belief is not None
    for wrong in (None, mdm.models.MDP([[[1.0]]], [[0.0]], discount=0.9)):
        with pytest.raises(mdm.ConfigError, match="false negatives need a POMDP"):
            with_false_negatives(wrong, "hear-left")
