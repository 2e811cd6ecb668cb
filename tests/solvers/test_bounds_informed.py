from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from random_models import dense, factored_models, flat_models

from mdm.models import POMDP
from mdm.problems import tiger
from mdm.solvers import Limits, solve
from mdm.solvers.bounds import fast_informed_bound, qmdp


def joints(model):
    """Return P(s', o | s, a) as an A x O x S x S' array, what is missing as one more observation."""
    result = []
    for a in range(len(model.action_space)):
        transition = dense(model.transition_matrix(a))
        if model.event_observations:
            told = [transition * dense(model.event_matrix(a, o)) for o in range(len(model.observation_space))]
        else:
            told = [transition * column for column in dense(model.observation_matrix(a)).T]
        result.append([*told, np.maximum(transition - sum(told), 0)])
    return np.array(result)


def plain(model, joint, backups=600):
    """Return the bound's vectors by its equation, from values that are too high."""
    vectors = np.full(model.rewards.T.shape, np.abs(model.rewards).max() / (1 - model.discount))
    for _ in range(backups):
        after = np.einsum("aosn,bn->aosb", joint, vectors)
        vectors = model.rewards.T + model.discount * after.max(axis=-1).sum(axis=1)
    return vectors


def expectimax(model, joint, belief, depth):
    """Return what can be earned in some steps."""
    if not depth:
        return 0.0
    best = -np.inf
    for a in range(len(model.action_space)):
        worth = belief @ model.rewards[:, a]
        for matrix in joint[a]:
            after = belief @ matrix
            if after.sum() > 1e-12:
                worth += model.discount * expectimax(model, joint, after / after.sum(), depth - 1) * after.sum()
        best = max(best, worth)
    return best


@given(model=flat_models(kinds=("POMDP",), events=True) | factored_models(events=True))
def test_vectors_are_those_of_the_equation(model):
    if model.kind == "MDP":
        return
    model = model.with_discount(0.9 if model.discount == 1 else model.discount)
    joint = joints(model.flatten())
    truth = plain(model, joint)
    found = fast_informed_bound(model, limits=Limits(gap=1e-5))
    assert found.policy.actions == list(range(len(model.action_space)))
    assert (found.policy.vectors >= truth - 1e-7 * (1 + abs(truth))).all()
    assert (found.policy.vectors <= truth + 1e-5 + 1e-7 * (1 + abs(truth))).all()
    assert found.lower == -np.inf
    assert found.reason == "converged"
    above = qmdp(model, limits=Limits(gap=1e-5))
    assert found.upper <= above.upper + 1e-5
    least = model.rewards.min() * model.discount**2 / (1 - model.discount)
    assert found.upper >= expectimax(model, joint, model.initial_belief, 2) + least - 1e-6


@pytest.mark.parametrize("limit", [1, 3, 20])
def test_it_bounds_wherever_it_stops(limit):
    reports = []
    found = solve(tiger(), "fib", iterations=limit, progress=reports.append)
    assert all(report.upper >= 19.3713 for report in reports)
    assert found.upper >= 19.3713
    assert (np.diff([report.upper for report in reports]) <= 1e-9).all()


def test_without_a_discount():
    # The end pays if the right one of two doors is taken; what is seen tells nothing.
    doors = np.zeros((2, 3, 3))
    doors[:, :, 2] = 1
    rewards = [[1, 0], [0, 1], [0, 0.0]]
    blind = POMDP(doors, np.ones((2, 3, 1)), rewards, discount=1, initial_belief=[0.5, 0.5, 0])
    found = fast_informed_bound(blind)
    assert found.upper == pytest.approx(0.5)
    np.testing.assert_allclose(found.policy.vectors, [[1, 0, 0], [0, 1, 0]])
