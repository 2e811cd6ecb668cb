"""Policy iteration where rewards differ by many orders of magnitude, against exact arithmetic over all policies."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from mdm.models import MDP
from mdm.solvers import Limits
from mdm.solvers.mdp.policy_iteration import policy_iteration

MAGNITUDES = [-12, -6, 0, 6, 12]


def solved(matrix, numbers):
    """Return the solution of a linear system of fractions, or None if it has not one."""
    rows = [[*row, number] for row, number in zip(matrix, numbers, strict=True)]
    size = len(rows)
    for column in range(size):
        pivot = next((row for row in range(column, size) if rows[row][column]), None)
        if pivot is None:
            return None
        rows[column], rows[pivot] = rows[pivot], rows[column]
        for row in range(size):
            if row != column and rows[row][column]:
                factor = rows[row][column] / rows[column][column]
                rows[row] = [x - factor * y for x, y in zip(rows[row], rows[column], strict=True)]
    return [rows[row][size] / rows[row][row] for row in range(size)]


def worth(model, policy):
    """Return the exact value of each state but the last, which rests; None where the policy does not get there."""
    size = len(policy)
    chances = [model.transition(action, state) for state, action in enumerate(policy)]
    matrix = [
        [
            Fraction(int(row == column)) - Fraction(model.discount) * Fraction(chances[row][column])
            for column in range(size)
        ]
        for row in range(size)
    ]
    return solved(matrix, [Fraction(model.rewards[state, action]) for state, action in enumerate(policy)])


@st.composite
def costly_models(draw):
    """Return a model of costs from a trillionth to a trillion, whose last state rests and can always be reached."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, count = draw(st.integers(2, 4)), draw(st.integers(2, 3))
    transitions = np.zeros((count, size, size))
    for action, state in itertools.product(range(count), range(size - 1)):
        transitions[action, state, random.integers(size)] = 0.5
        transitions[action, state, random.integers(size)] += 0.5
    staying = random.random((count, size)) < 0.5
    transitions[staying] = (
        transitions[staying] / 16 + 15 / 16 * np.broadcast_to(np.eye(size), transitions.shape)[staying]
    )
    transitions[0] *= 0.75
    transitions[0, :, -1] += 0.25
    transitions[:, -1] = np.eye(size)[-1]
    rewards = -random.integers(1, 9, size=(size, count)) * 10.0 ** random.choice(MAGNITUDES, size=(size, 1))
    rewards[-1] = 0
    start = np.eye(size)[random.integers(size - 1)]
    discount = draw(st.sampled_from([0.5, 0.95, 1]))
    return MDP(transitions, rewards, discount=discount, initial_belief=start, sparse=draw(st.booleans()))


@given(model=costly_models())
@settings(max_examples=60)
def test_what_it_calls_exact_is_best_however_large_the_costs_elsewhere(model):
    found = policy_iteration(model, limits=Limits(gap=0))
    states, actions = len(model.state_space) - 1, range(len(model.action_space))
    worths = [worth(model, policy) for policy in itertools.product(actions, repeat=states)]
    best = [max(values) for values in zip(*[w for w in worths if w is not None and max(w) <= 0], strict=True)]
    start = int(model.initial_belief.argmax())
    assert found.lower == found.upper == pytest.approx(float(best[start]), rel=1e-9)
    assert float(worth(model, [found.policy.action(s) for s in range(states)])[start]) == pytest.approx(found.lower)


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("discount", [0.9, 1])
@pytest.mark.parametrize("penalty", [1e12, 1e300, 1e308])
def test_a_forbidden_state_hides_no_difference_elsewhere(penalty, discount, sparse):
    slow, fast = [[0.9, 0.1, 0], [0, 1, 0], [0, 1, 0]], [[0, 1, 0], [0, 1, 0], [0, 1, 0]]
    costs = [[-0.002, -0.001], [0, 0], [-penalty, -penalty]]
    model = MDP([slow, fast], costs, discount=discount, initial_belief=[1, 0, 0], sparse=sparse)
    found = policy_iteration(model, limits=Limits(gap=0))
    assert found.policy.action(0) == 1
    assert found.lower == found.upper == pytest.approx(-0.001)


def test_the_smallest_rewards_are_told_apart():
    model = MDP([np.eye(1), np.eye(1)], [[1e-300, 3e-300]], discount=0.9)
    found = policy_iteration(model, limits=Limits(gap=0))
    assert found.lower == found.upper == pytest.approx(3e-299, rel=1e-9)
