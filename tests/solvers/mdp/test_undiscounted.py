"""A discount of 1: what comes to rest is solved, and what does not is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_models import distributions

from mdm.errors import ModelError
from mdm.models import MDP
from mdm.solvers import Limits
from mdm.solvers.mdp.policy_iteration import modified_policy_iteration, policy_iteration
from mdm.solvers.mdp.prioritised_sweeping import prioritised_sweeping
from mdm.solvers.mdp.value_iteration import value_iteration

every_solver = pytest.mark.parametrize(
    "solver", [value_iteration, prioritised_sweeping, policy_iteration, modified_policy_iteration]
)
STAY, ON = np.eye(3), np.array([[0, 1, 0], [0, 0, 1], [0, 0, 1.0]])


@st.composite
def ending_models(draw):
    """Return a model with costs, whose last state rests and can be reached from everywhere."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, count = draw(st.integers(2, 4)), draw(st.integers(1, 3))
    transitions = distributions(random, count, size, size)
    transitions[:, -1] = np.eye(size)[-1]
    transitions[0] = 0.7 * transitions[0]
    transitions[0, :, -1] += 0.3
    rewards = -random.integers(1, 5, size=(size, count)).astype(float)
    rewards[-1] = 0
    return MDP(transitions, rewards, discount=1, sparse=draw(st.booleans()))


@every_solver
@given(model=ending_models())
@settings(max_examples=25)
def test_values_are_those_of_the_best_of_all_policies(solver, model):
    found = solver(model, limits=Limits(gap=0))
    size = len(model.state_space)
    worths = []
    for actions in itertools.product(range(len(model.action_space)), repeat=size - 1):
        rows = np.array([model.transition(action, state) for state, action in enumerate(actions)])
        system = np.eye(size - 1) - rows[:, :-1]
        if np.linalg.cond(system) < 1e12:  # others never end, at endless cost
            earned = [model.rewards[state, action] for state, action in enumerate(actions)]
            worths.append([*np.linalg.solve(system, earned), 0])
    best = np.max(worths, axis=0)
    np.testing.assert_allclose(found.policy.values.max(axis=1), best, atol=1e-8)
    np.testing.assert_allclose([found.lower, found.upper], model.initial_belief @ best, atol=1e-8)
    assert found.reason in {"exact", "gap"}


@every_solver
def test_the_policy_goes_on_where_waiting_is_worth_the_same(solver):
    # In a corridor whose end pays once, to wait costs nothing: both actions are worth the same.
    rewards = np.array([[0, 0], [0, 1], [0, 0.0]])
    found = solver(MDP([STAY, ON], rewards, discount=1), limits=Limits(gap=0))
    assert [found.policy.action(state) for state in range(2)] == [1, 1]
    np.testing.assert_allclose(found.policy.values.max(axis=1), [1, 1, 0])


@every_solver
def test_to_rest_may_be_the_best(solver):
    # The end costs something to come to; to wait is free.
    rewards = np.array([[0, -1], [0, -1], [0, 0.0]])
    found = solver(MDP([STAY, ON], rewards, discount=1), limits=Limits(gap=0))
    assert [found.policy.action(state) for state in range(2)] == [0, 0]
    np.testing.assert_allclose(found.policy.values.max(axis=1), 0)


@every_solver
@pytest.mark.parametrize("sparse", [False, True])
def test_no_end(solver, sparse):
    rewards = np.array([[-1, -1], [-1, -1], [-1, -1.0]])
    with pytest.raises(ModelError, match="discount is 1, but from state '0' no policy comes to where nothing more"):
        solver(MDP([STAY, ON], rewards, discount=1, sparse=sparse))


@every_solver
@pytest.mark.parametrize("sparse", [False, True])
def test_rewards_without_end(solver, sparse):
    rewards = np.array([[0, -1], [2, 1], [0, 0.0]])
    with pytest.raises(ModelError, match="from state '[01]' rewards can be earned without end"):
        solver(MDP([STAY, ON], rewards, discount=1, sparse=sparse))


@every_solver
def test_a_long_corridor(solver):
    size = 300
    on = np.eye(size, k=1)
    on[-1, -1] = 1
    rewards = np.full((size, 2), -1.0)
    rewards[-1] = 0
    found = solver(MDP([np.eye(size), on], rewards, discount=1, sparse=True), limits=Limits(gap=0))
    np.testing.assert_allclose(found.policy.values.max(axis=1), np.arange(size) - size + 1)
