"""Loss of value, against values of models with the row replaced."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import visits
from hypothesis import given, strategies as st

import mdm
from mdm import ModelError
from mdm.estimation import chains_of, counted, reestimated, transition_rows
from mdm.estimation.loss import Values, decided_policy, losses
from mdm.estimation.rows import row_of
from mdm.models import MDP
from mdm.solvers.evaluation import state_values


def random_model(seed, *, sparse=False, outcomes=False):
    random = np.random.default_rng(seed)
    transitions = random.dirichlet(np.ones(5), (2, 5))
    rewards = random.normal(size=(2, 5, 5) if outcomes else (5, 2))
    start = random.dirichlet(np.ones(5))
    return MDP(transitions, rewards, discount=0.9, initial_belief=start, sparse=sparse)


def value(model, policy):
    """Return the value of a policy at the start, by plain equations."""
    matrix = np.array([model.transition(int(a), s) for s, a in enumerate(policy)])
    rewards = np.array([model.rewards[s, a] for s, a in enumerate(policy)])
    return float(model.initial_belief @ np.linalg.solve(np.eye(5) - model.discount * matrix, rewards))


@given(st.integers(0, 1000), st.booleans(), st.booleans())
def test_a_row_s_loss_is_the_difference_of_two_models(seed, sparse, outcomes):
    model = random_model(seed, sparse=sparse, outcomes=outcomes)
    random = np.random.default_rng(seed)
    policy = random.integers(0, 2, 5)
    counts = dict(enumerate(random.integers(0, 9, 5).tolist()))
    row = row_of(int(policy[3]), 3, np.arange(5), np.array(model.transition(int(policy[3]), 3)), counts)
    values = Values(model, policy)
    assert values.start == pytest.approx(value(model, policy))
    transitions = np.array([[model.transition(action, state) for state in range(5)] for action in (0, 1)])
    transitions[row.action, 3] = row.estimates
    rewards = model.outcome_rewards.array(1000) if outcomes else model.rewards
    other = MDP(transitions, rewards, discount=0.9, initial_belief=model.initial_belief)
    (loss,) = losses(model, values, [row], "steps")
    assert loss == pytest.approx(value(model, policy) - value(other, policy), abs=1e-9)


def test_the_values_are_those_of_the_solvers():
    model = mdm.problems.forest()
    policy = mdm.solve(model).policy
    actions = [policy.action(state) for state in range(3)]
    assert Values(model, actions).values == pytest.approx(state_values(model, policy))


def test_an_action_that_the_policy_does_not_take_loses_nothing_that_is_known():
    model = random_model(1)
    row = row_of(1, 2, np.arange(5), np.array(model.transition(1, 2)), {0: 4})
    assert losses(model, Values(model, [0] * 5), [row], "steps") == [None]


def test_a_row_of_jumps_keeps_the_old_probability_of_staying():
    model = random_model(2)
    chains = chains_of(visits([0, 1, 0, 2, 0, 1]))
    row = transition_rows(model, counted(chains.stays()), "jumps")[0]
    stays = float(model.transition(0, 0, 0))
    (loss,) = losses(model, Values(model, [0] * 5), [row], "jumps")
    transitions = np.array([model.transition_matrix(0), model.transition_matrix(1)])
    transitions[0, 0, 1:] = row.estimates * (1 - stays)
    other = MDP(transitions, model.rewards, discount=0.9, initial_belief=model.initial_belief)
    assert loss == pytest.approx(value(model, [0] * 5) - value(other, [0] * 5))


def test_the_policy_is_what_was_decided_and_the_best_elsewhere():
    model = mdm.problems.forest()
    best = [mdm.solve(model).policy.action(state) for state in range(3)]
    assert decided_policy(model, []).tolist() == best
    other = 1 - best[0]
    told = chains_of(visits([0, 1, 0, 1], actions=[other, best[1], other, best[1]])).chains
    assert decided_policy(model, told)[0] == other


def test_with_a_discount_of_one_there_is_no_value():
    with pytest.raises(ModelError, match="where the discount is less than 1"):
        Values(mdm.problems.forest().with_discount(1), [0, 0, 0])


def test_the_sum_of_nothing_is_no_loss():
    model = random_model(3)
    assert reestimated(model, []).transition_matrix(0).tolist() == model.transition_matrix(0).tolist()
