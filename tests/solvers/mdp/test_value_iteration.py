"""To a horizon, against plain recursion; the other tests are those of every solver."""

from __future__ import annotations

from functools import cache

import numpy as np
from hypothesis import given, strategies as st
from random_models import flat_models
from sentences import refused

from mdm.errors import ConfigError
from mdm.models import MDP
from mdm.policies import StagedPolicy
from mdm.solvers import Limits, solve
from mdm.solvers.mdp.value_iteration import value_iteration


def recursion(model, horizon):
    """Return Q(s, a) with so many decisions to go, one state at a time."""
    states, actions = range(len(model.state_space)), range(len(model.action_space))
    chances = [[np.array(model.transition(a, s)) for a in actions] for s in states]

    @cache
    def q_value(state, action, left):
        ahead = 0.0
        for after, chance in enumerate(chances[state][action]):
            if chance and left > 1:
                ahead += chance * max(q_value(after, other, left - 1) for other in actions)
        return model.rewards[state, action] + model.discount * ahead

    return np.array([[[q_value(s, a, horizon - stage) for a in actions] for s in states] for stage in range(horizon)])


@given(model=flat_models(kinds=("MDP",)), horizon=st.integers(1, 5))
def test_horizon_is_plain_recursion(model, horizon):
    found = value_iteration(model, limits=Limits(gap=0), horizon=horizon)
    truth = recursion(model, horizon)
    assert isinstance(found.policy, StagedPolicy)
    if found.iterations == horizon:  # where nothing is to be decided, it may stop before
        np.testing.assert_allclose(found.policy.values, truth, atol=1e-9, rtol=1e-12)
        assert found.reason in {"exact", "gap"}
    value = model.initial_belief @ truth[0].max(axis=1)
    assert found.lower - 1e-9 <= value <= found.upper + 1e-9


@given(model=flat_models(kinds=("MDP",)), horizon=st.integers(2, 6), limit=st.integers(1, 4))
def test_bounds_hold_where_stages_are_missing(model, horizon, limit):
    found = value_iteration(model, limits=Limits(gap=0, iterations=limit), horizon=horizon)
    value = model.initial_belief @ recursion(model, horizon)[0].max(axis=1)
    assert found.lower - 1e-9 <= value <= found.upper + 1e-9
    assert found.policy.horizon == horizon
    assert worth(model, found.policy) >= found.lower - 1e-9


def worth(model, policy):
    """Return what a staged policy earns from the start, by pushing the belief on."""
    belief, total = np.array(model.initial_belief), 0.0
    for stage in range(policy.horizon):
        after = np.zeros_like(belief)
        for state, chance in enumerate(belief):
            action = policy.action(state, stage)
            total += model.discount**stage * chance * model.rewards[state, action]
            after += chance * model.transition(action, state)
        belief = after
    return total


def test_undiscounted_horizon_needs_no_rest():
    model = MDP([np.eye(1)], [[1.0]], discount=1)
    found = solve(model, "value-iteration", gap=0, horizon=7)
    assert (found.lower, found.upper) == (7, 7)


def test_horizon_of_nothing():
    with refused(ConfigError):
        value_iteration(MDP([np.eye(1)], [[1.0]], discount=1), horizon=0)
