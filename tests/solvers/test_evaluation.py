"""Exact values of policies, against recursion over decisions and against linear algebra that is written out."""

from __future__ import annotations

import warnings

import figures
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from places import EXAMPLES
from random_models import dense, distributions, flat_models
from sentences import refused

from mdm import ModelError, ModelWarning, evaluate, load_model
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    QTable,
    StochasticPolicy,
)
from mdm.problems import tiger
from mdm.solvers import controller_values, exact_values, state_values

SEEDS = st.integers(0, 2**32 - 1)


def random_controller(random, nodes, actions, observations, *, ends=False):
    after = random.integers(nodes, size=(nodes, observations)).tolist()
    if ends:
        after[0][0] = None
    return FiniteStateController(random.integers(actions, size=nodes).tolist(), after, actions)


def by_recursion(model, controller, steps, false_negative=None):
    """Return the worth of each node from each state after so many decisions, event by event."""
    size, width = len(model.state_space), len(model.observation_space)
    detected = [o for o in range(width) if o != false_negative]
    last = [model.rewards[:, action] for action in controller.actions]
    values = last
    for _ in range(steps - 1):
        now = []
        for node, action in enumerate(controller.actions):
            joints = {o: dense(model.joint_matrix(action, o)) for o in detected}
            missed = dense(model.transition_matrix(action)) - sum(joints.values())
            total = model.rewards[:, action].copy()
            for o in detected:
                after = controller.successors[node][o]
                if after is not None:
                    total += model.discount * joints[o] @ values[after]
            now.append(np.linalg.solve(np.eye(size) - model.discount * missed, total))
        values = now
    return np.stack(values)


@given(flat_models(finer=False), SEEDS)
@settings(max_examples=25)
def test_tables_solve_their_equation_and_its_repetition_comes_close(model, seed):
    model = model.with_discount(min(model.discount, 0.9))
    random = np.random.default_rng(seed)
    size, count = model.rewards.shape
    weights = distributions(random, size, count)
    policy = StochasticPolicy(weights.T)
    moves = sum(weights[:, [a]] * dense(model.transition_matrix(a)) for a in range(count))
    earned = (weights * model.rewards).sum(axis=1)
    repeated = np.zeros(size)
    for step in range(1, 400):
        repeated = earned + model.discount * moves @ repeated
        if step == 3:
            np.testing.assert_allclose(state_values(model, policy, steps=3), repeated, atol=1e-10)
    np.testing.assert_allclose(state_values(model, policy), repeated, atol=1e-9)
    actions = random.integers(count, size=size)
    one, other = DeterministicPolicy(actions, count), QTable(np.eye(count)[actions])
    assert np.array_equal(state_values(model, one), state_values(model, other))
    greedy = StochasticPolicy(np.eye(count)[:, actions])
    np.testing.assert_allclose(state_values(model, one), state_values(model, greedy), atol=1e-9)


@given(flat_models(kinds=("POMDP",), events=True, finer=False), SEEDS, st.booleans())
@settings(max_examples=25)
def test_controllers_are_worth_what_recursion_says(model, seed, ends):
    model = model.with_discount(min(model.discount, 0.7))
    controller = random_controller(
        np.random.default_rng(seed), 3, len(model.action_space), len(model.observation_space), ends=ends
    )
    np.testing.assert_allclose(
        controller_values(model, controller, steps=3), by_recursion(model, controller, 3), atol=1e-9
    )
    np.testing.assert_allclose(controller_values(model, controller), by_recursion(model, controller, 60), atol=1e-6)


def events_model(seed, *, sparse=False):
    random = np.random.default_rng(seed)
    told = 0.95 * np.moveaxis(random.dirichlet(np.ones(3), size=(2, 4, 4)), -1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return POMDP(
            random.dirichlet(np.ones(4), size=(2, 4)),
            told,
            random.normal(size=(4, 2)),
            discount=0.85,
            event_observations=True,
            sparse=sparse,
        )


@pytest.mark.parametrize("sparse", [False, True])
def test_controllers_with_false_negatives(sparse):
    model = events_model(3, sparse=sparse)
    controller = random_controller(np.random.default_rng(5), 3, 2, 3)
    missing = model.with_false_negatives(1)
    for steps in (1, 4):
        values = controller_values(missing, controller, steps=steps)
        np.testing.assert_allclose(values, by_recursion(model, controller, steps, 1), atol=1e-9)
    endless = exact_values(missing, controller)
    np.testing.assert_allclose(endless, by_recursion(model, controller, 400, 1)[controller.start], atol=1e-8)
    result = evaluate(missing, controller, seed=1)
    assert abs(result.mean - model.initial_belief @ endless) < 4 * result.standard_error


def test_a_team_s_controllers_as_one():
    random = np.random.default_rng(2)
    team = POMDP(
        random.dirichlet(np.ones(3), size=(4, 3)),
        random.dirichlet(np.ones(6), size=(4, 3)),
        random.normal(size=(3, 4)),
        discount=0.9,
        actions=Space([Factor("a", 2), Factor("b", 2)]),
        observation_names=Space([Factor("a", 2), Factor("b", 3)]),
    )
    joint = JointController([random_controller(random, 3, 2, 2), random_controller(random, 2, 2, 3, ends=True)])
    one = joint.joined()
    nodes, node = joint.start, 0
    for observation in random.integers(6, size=50).tolist():
        assert one.actions[node] == team.action_space.ravel(joint.actions_at(nodes))
        after = joint.next_nodes(nodes, divmod(observation, 3))
        if None in after:
            assert one.successors[node][observation] is None
        else:
            nodes, node = after, one.successors[node][observation]
    exact = team.initial_belief @ exact_values(team, joint)
    result = evaluate(team, joint, seed=1)
    assert abs(result.mean - exact) < 4 * result.standard_error


def test_an_optimal_plan_is_worth_what_its_nodes_say():
    plan = figures.tiger_plan()
    np.testing.assert_allclose(controller_values(tiger(), plan), plan.values, atol=1e-4)


@pytest.mark.parametrize("discount", [0.95, 1])
def test_large_systems_are_solved_to_the_last_digits(discount):
    """A ring of 5,000 places, each the way to the next or, at the end of a lap, out."""
    from scipy import sparse

    size = 5_000
    random = np.random.default_rng(1)
    ways = [
        sparse.csr_array((np.ones(size), (np.arange(size), np.minimum(np.arange(size) + step, size - 1))))
        for step in (1, 2)
    ]
    rewards = random.normal(size=(size, 2))
    rewards[-1] = 0
    model = MDP(ways, rewards, discount=discount, sparse=True)
    actions = random.integers(2, size=size)
    values = np.zeros(size)
    for state in range(size - 2, -1, -1):
        values[state] = rewards[state, actions[state]]
        values[state] += discount * values[min(state + 1 + actions[state], size - 1)]
    np.testing.assert_allclose(state_values(model, DeterministicPolicy(actions, 2)), values, atol=1e-6)


def test_what_has_no_exact_value_or_no_bound():
    model = load_model(EXAMPLES / "tiger.pomdp")
    assert exact_values(model, AlphaVectors([[0, 0]], [0], 3)) is None
    assert exact_values(MDP([np.eye(2)], [[0.0], [0.0]], discount=0.9), FiniteStateController([0], [[0]])) is None
    listening, tree = FiniteStateController([0], [[0, 0]], 3), FiniteStateController([0, 0], [[1, 1], [None, None]], 3)
    forever = model.with_discount(1)
    assert exact_values(model, listening) == pytest.approx([-20, -20])
    assert exact_values(forever, tree) == pytest.approx([-2, -2])
    with refused(ModelError):
        exact_values(forever, listening)
    assert exact_values(forever, listening, steps=5) == pytest.approx([-5, -5])
    with refused(ModelError):
        state_values(model, DeterministicPolicy([0, 0, 0], 3))
    with refused(ModelError):
        controller_values(model, FiniteStateController([0], [[0] * 5], 3))
