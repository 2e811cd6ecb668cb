"""Rewards in every form, and their expectation by single outcomes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import distributions
from sentences import refused

from mdm import ModelError
from mdm.models import MDP, POMDP


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 2), st.integers(1, 3), st.booleans(), st.booleans())
def test_expectations_by_single_outcomes(seed, size, count, width, sparse, events):
    random = np.random.default_rng(seed)
    transitions = distributions(random, count, size, size)
    told = distributions(random, count, size, size, width)
    if not events:
        told = np.broadcast_to(told[:, :1], told.shape)
    given_ = np.moveaxis(told, -1, 1) if events else told[:, 0]
    options = {"discount": 0.9, "sparse": sparse, "event_observations": events}
    forms = {
        "s": random.normal(size=size),
        "sa": random.normal(size=(size, count)),
        "ast": random.normal(size=(count, size, size)),
        "asto": random.normal(size=(count, size, size, width)),
    }
    full = {
        "s": np.broadcast_to(forms["s"][None, :, None, None], (count, size, size, width)),
        "sa": np.broadcast_to(forms["sa"].T[:, :, None, None], (count, size, size, width)),
        "ast": np.broadcast_to(forms["ast"][..., None], (count, size, size, width)),
        "asto": forms["asto"],
    }
    for form, rewards in forms.items():
        model = POMDP(transitions, given_, rewards, **options)
        for a, s in np.ndindex(count, size):
            expected = sum(
                transitions[a, s, t] * told[a, s, t, o] * full[form][a, s, t, o] for t, o in np.ndindex(size, width)
            )
            assert model.rewards[s, a] == pytest.approx(expected, abs=1e-9)
            assert model.reward(a, s) == model.rewards[s, a]
            for t, o in np.ndindex(size, width):
                assert model.reward(a, s, t, o) == pytest.approx(
                    full[form][a, s, t, o] if form in {"ast", "asto"} else model.rewards[s, a]
                )
        assert (model.outcome_rewards is None) == (form in {"s", "sa"})
        if form != "asto":
            plain = MDP(transitions, rewards, discount=0.9, sparse=sparse)
            np.testing.assert_allclose(plain.rewards, model.rewards, atol=1e-9)


def test_rewards_over_observations_need_some():
    with refused(ModelError):
        MDP([np.eye(2)], np.zeros((1, 2, 2, 3)), discount=0.9)
    model = POMDP([np.eye(2)], [np.eye(2)], np.arange(8.0).reshape(1, 2, 2, 2), discount=0.9)
    with refused(ModelError):
        model.reward(0, 0, 0)


@pytest.mark.parametrize("rewards", [np.zeros((2, 2, 2, 2, 2)), np.zeros((1, 2, 3)), [[1], [1, 2]], np.zeros((0, 1))])
def test_other_shapes_are_refused(rewards):
    with pytest.raises(ModelError):
        MDP([np.eye(2)], rewards, discount=0.9)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_with_its_place(wrong):
    options = {"discount": 0.9, "states": ["low", "high"], "actions": ["wait"]}
    message = f"action 'wait' in state 'high' is {wrong}, not a finite number"
    finer = np.zeros((1, 2, 2, 2))
    for rewards in ([0, wrong], [[0], [wrong]], [[[0, 0], [0, wrong]]]):
        with pytest.raises(ModelError, match=message):
            MDP([np.eye(2)], rewards, **options)
    finer[0, 1, 1, 1] = wrong
    with pytest.raises(ModelError, match=message):
        POMDP([np.eye(2)], [np.full((2, 2), 0.5)], finer, **options)
    finer[0, 1, 1, 1], finer[0, 1, 0, 0] = 1, wrong  # from high, low is never reached
    assert POMDP([np.eye(2)], [np.full((2, 2), 0.5)], finer, **options).rewards.tolist() == [[0], [0.5]]


def test_arrays_of_outcomes_are_given_back_unless_too_large():
    values = np.arange(4.0).reshape(1, 2, 2)
    kept = MDP([np.eye(2)], values, discount=0.9).outcome_rewards
    assert kept.array(4).tolist() == values.tolist()
    assert kept.array(3) is None
