"""Episodes one by one, against the batch and against recursion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from random_models import flat_models
from recursion import FEW, SEEDS, assert_within, by_recursion, vectors_for

from mdm import evaluate
from mdm.models import POMDP
from mdm.policies import (
    DeterministicPolicy,
    StatePolicy,
)
from mdm.simulation.batch import Limits, one_by_one


@FEW
@given(flat_models(kinds=("POMDP",), finer=False), SEEDS)
def test_episodes_one_by_one_are_worth_the_same(model, seed):
    model = model.with_discount(min(model.discount, 0.9))
    policy = vectors_for(model, np.random.default_rng(seed))

    class Own:  # no more than what the protocol of a policy asks for
        num_actions, information, action = policy.num_actions, policy.information, policy.action

    result = evaluate(model, Own(), episodes=300, steps=3, seed=seed)
    assert_within(result, by_recursion(model, policy, 3))
    assert np.array_equal(result.returns[:50], evaluate(model, Own(), episodes=50, steps=3, seed=seed).returns)


@pytest.mark.parametrize("episodes", [1000, pytest.param(3000, marks=pytest.mark.slow)])
def test_one_by_one_with_false_negatives_and_by_state(episodes):
    random = np.random.default_rng(4)
    told = np.moveaxis(random.dirichlet(np.ones(3), size=(2, 3, 3)), -1, 1)
    model = POMDP(
        random.dirichlet(np.ones(3), size=(2, 3)),
        told,
        random.normal(size=(3, 2)),
        discount=0.8,
        event_observations=True,
    )
    policy = vectors_for(model, random)
    exact = by_recursion(model, policy, 4, false_negative=1)
    returns, moves = one_by_one(model.with_false_negatives(1), policy, Limits(4, np.inf), episodes=episodes, seed=1)
    assert abs(returns.mean() - exact) < 5 * returns.std() / np.sqrt(episodes)
    assert moves > 4 * episodes

    class Own(StatePolicy):
        num_states, num_actions = 3, 2

        def action(self, state):
            return state % 2

    table = DeterministicPolicy([0, 1, 0])
    ours, theirs = (evaluate(model, each, episodes=episodes, seed=1) for each in (Own(), table))
    assert abs(ours.mean - theirs.mean) < 5 * (ours.standard_error + theirs.standard_error)
