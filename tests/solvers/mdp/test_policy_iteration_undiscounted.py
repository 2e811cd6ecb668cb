"""A discount of 1: what comes to rest is solved, and what does not is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_models import distributions
from sentences import refused

from mdm import problems
from mdm.errors import ModelError
from mdm.models import MDP
from mdm.solvers import Limits
from mdm.solvers.mdp.policy_iteration import policy_iteration
from mdm.solvers.mdp.value_iteration import modified_policy_iteration, prioritised_sweeping, value_iteration

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


@st.composite
def mixed_models(draw):
    """Return a model with rewards of both signs, in which policies rest, gain for ever, or neither."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, count = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    transitions = distributions(random, count, size, size)
    if draw(st.booleans()):
        transitions = np.eye(size)[transitions.argmax(axis=-1)]
    rewards = random.integers(-3, 2, size=(size, count)) * (random.random((size, count)) < 0.6)
    if draw(st.booleans()):
        transitions[:, -1], rewards[-1] = np.eye(size)[-1], 0
    return MDP(transitions, rewards.astype(float), discount=1, sparse=draw(st.booleans()))


def chain_of(model, actions):
    """Return the values of a policy that rests from everywhere, else None; and the greatest mean reward for ever."""
    rows = np.array([model.transition(action, state) for state, action in enumerate(actions)])
    earned = np.array([model.rewards[state, action] for state, action in enumerate(actions)])
    size = len(earned)
    ways = np.linalg.matrix_power((rows > 0) | np.eye(size, dtype=bool), size) > 0  # who can come where
    gain, rests = 0.0, np.zeros(size, dtype=bool)
    for state in range(size):
        (those,) = ways[state].nonzero()
        if not ways[np.ix_(those, those)].all():
            continue  # it can be left for ever
        inner = rows[np.ix_(those, those)]
        system = np.vstack([inner.T - np.eye(len(those)), np.ones(len(those))])
        often = np.linalg.lstsq(system, np.append(np.zeros(len(those)), 1), rcond=None)[0]
        gain = max(gain, float(often @ earned[those]))
        rests[state] = not earned[those].any()
    values = np.zeros(size)
    if not all(rests[ways[state]].any() for state in range(size)):
        return None, gain
    on = ~rests
    values[on] = np.linalg.solve(np.eye(on.sum()) - rows[np.ix_(on, on)], earned[on])
    return values, gain


@every_solver
@given(model=mixed_models())
@settings(max_examples=40)
def test_it_is_solved_or_refused_for_the_right_reason(solver, model):
    policies = itertools.product(range(len(model.action_space)), repeat=len(model.state_space))
    found = [chain_of(model, actions) for actions in policies]
    values = [value for value, _ in found if value is not None]
    if not values:
        with pytest.raises(ModelError, match="no policy comes to rest, where nothing more"):
            solver(model)
    elif max(gain for _, gain in found) > 1e-9:
        with pytest.raises(ModelError, match="rewards can be earned without end, by"):
            solver(model)
    else:
        solution = solver(model, limits=Limits(gap=0))
        best = np.max(values, axis=0)
        np.testing.assert_allclose(solution.policy.values.max(axis=1), best, atol=1e-7)
        np.testing.assert_allclose([solution.lower, solution.upper], model.initial_belief @ best, atol=1e-7)
        earned, _ = chain_of(model, [solution.policy.action(state) for state in range(len(best))])
        assert earned is not None  # what it chooses comes to rest, too
        np.testing.assert_allclose(earned, best, atol=1e-7)


@every_solver
def test_the_grid_world_of_the_textbook(solver):
    """S. Russell and P. Norvig, *Artificial Intelligence: a modern approach*, figure 17.3."""
    model = problems.grid_world()
    assert model.discount == 1
    solution = solver(model)
    values = solution.policy.values.max(axis=1)
    published = [0.812, 0.868, 0.918, 1, 0.762, 0.660, -1, 0.705, 0.655, 0.611, 0.388, 0]
    np.testing.assert_allclose(values, published, atol=5e-4)
    assert solution.lower == solution.upper == pytest.approx(0.705, abs=5e-4)
    actions = [solution.policy.action(state) for state in range(12)]
    rows = np.array([model.transition(action, state) for state, action in enumerate(actions)])
    earned = [model.rewards[state, action] for state, action in enumerate(actions)]
    exact = np.linalg.solve(np.eye(11) - rows[:-1, :-1], earned[:-1])  # the last is where episodes end
    np.testing.assert_allclose(values[:-1], exact, atol=1e-12)


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
    with refused(ModelError):
        solver(MDP([STAY, ON], rewards, discount=1, sparse=sparse))


@every_solver
@pytest.mark.parametrize("sparse", [False, True])
def test_rewards_without_end(solver, sparse):
    rewards = np.array([[0, -1], [2, 1], [0, 0.0]])
    with refused(ModelError):
        solver(MDP([STAY, ON], rewards, discount=1, sparse=sparse))


@every_solver
def test_who_never_rests_and_who_gains_for_ever_are_named(solver):
    fall = np.eye(6)[[1, 2, 3, 4, 5, 5]]
    toll = np.full((6, 1), -1.0)
    states = ["hall", "stairs", "cellar", "well", "sewer", "sea"]
    with pytest.raises(ModelError) as caught:
        solver(MDP([fall], toll, discount=1, states=states))
    assert str(caught.value) == (
        "the discount is 1, but no policy comes to rest, where nothing more is earned or paid, from state 'hall', nor "
        "from 'stairs', 'cellar', 'well' and 2 more: give a discount below 1 (--discount), or plan for a horizon "
        "(--solver value-iteration --horizon)"
    )
    ways = np.stack([np.eye(3), np.eye(3)[[1, 0, 2]]])
    model = MDP(ways, [[0, 3], [0, -2], [0, 0]], discount=1, states=["shop", "mine", "home"], actions=["rest", "go"])
    with pytest.raises(ModelError) as caught:
        solver(model)
    assert str(caught.value) == (
        "the discount is 1, and from state 'shop' rewards can be earned without end, by 'go' in 'shop' and 'go' in "
        "'mine' again and again: give a discount below 1 (--discount), or plan for a horizon (--solver value-iteration "
        "--horizon)"
    )


@every_solver
def test_a_long_corridor(solver):
    size = 300
    on = np.eye(size, k=1)
    on[-1, -1] = 1
    rewards = np.full((size, 2), -1.0)
    rewards[-1] = 0
    found = solver(MDP([np.eye(size), on], rewards, discount=1, sparse=True), limits=Limits(gap=0))
    np.testing.assert_allclose(found.policy.values.max(axis=1), np.arange(size) - size + 1)
