"""The random and the constant policy: alone, in a control layer, and evaluated against linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from places import EXAMPLES
from random_models import dense, flat_models
from sentences import refused

from mdm import ModelError, evaluate, load_model, simulate
from mdm.policies import ConstantPolicy, Policy, RandomPolicy


def test_they_are_policies():
    for policy in (RandomPolicy(3, 2), ConstantPolicy(1, 3, 2, input="state")):
        typed: Policy = policy
        assert (typed.num_actions, typed.num_states) == (3, 2)
    assert RandomPolicy(3, 2).input == "belief"
    assert RandomPolicy(3, 2, input="state").input == "state"
    assert ConstantPolicy(1, 3, 2).action(np.array([0.5, 0.5])) == 1


def test_the_same_seed_draws_the_same_actions():
    policy, other = RandomPolicy(5, 2, seed=7), RandomPolicy(5, 2, seed=7)
    drawn = [policy.action(0) for _ in range(2000)]
    assert drawn == [other.action(1) for _ in range(2000)]
    assert drawn != [policy.action(0) for _ in range(2000)]
    policy.seed(7)
    assert drawn == [policy.action(0) for _ in range(2000)]
    counts = np.bincount(drawn, minlength=5)
    assert len(counts) == 5
    assert (np.abs(counts - 400) < 100).all()  # five standard deviations and more


def worth(model, weights):
    """Return what a fixed distribution of actions earns from the start."""
    moves = sum(weight * dense(model.transition_matrix(a)) for a, weight in enumerate(weights))
    values = np.linalg.solve(np.eye(len(moves)) - model.discount * moves, model.rewards @ weights)
    return float(model.initial_belief @ values)


@given(flat_models(finer=False), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_they_earn_what_linear_algebra_says(model, seed):
    model = model.with_discount(min(model.discount, 0.8))
    actions, size = len(model.action_space), len(model.state_space)
    left_out = 2e-6 * np.abs(model.rewards).max() / (1 - model.discount)  # what comes after the last step, and rounding
    kinds = ["state"] if model.kind == "MDP" else ["state", "belief"]
    for kind in kinds:
        for policy, weights in (
            (RandomPolicy(actions, size, seed=seed, input=kind), np.full(actions, 1 / actions)),
            (ConstantPolicy(actions - 1, actions, size, input=kind), np.eye(actions)[-1]),
        ):
            result = evaluate(model, policy, episodes=2000, seed=seed)
            assert abs(result.mean - worth(model, weights)) < 6 * result.standard_error + left_out + 1e-9


def test_control_layers_run_them():
    model = load_model(EXAMPLES / "tiger.pomdp")
    always = simulate(model, ConstantPolicy(0, 3, 2), episodes=3, seed=1, steps=4)
    assert always.mean == pytest.approx(-sum(model.discount**step for step in range(4)))
    first, again = (simulate(model, RandomPolicy(3, 2, seed=4), episodes=20, seed=1, steps=9) for _ in range(2))
    assert np.array_equal(first.returns, again.returns)
    assert len(set(first.returns)) > 10


def test_refusals():
    with refused(ModelError):
        RandomPolicy(0, 2)
    with refused(ModelError):
        ConstantPolicy(0, 1, 0)
    with refused(ModelError):
        ConstantPolicy(3, 3, 2)
    with refused(ModelError):
        RandomPolicy(3, 2, input="observation")
    for policy in (RandomPolicy(3, 2), ConstantPolicy(1, 3, 2)):
        with refused(ModelError):
            policy.value(0)
