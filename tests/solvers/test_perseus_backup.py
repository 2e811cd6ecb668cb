"""Backups and what is kept of them, against plain computation at each belief."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from perseus_models import SEEDS, SMALL, parts

from mdm.models.dynamics import Dynamics
from mdm.solvers import Limits
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.perseus import Vectors, best, choose, improve, needed


def drawn(model, seed):
    """Return dynamics, beliefs and vectors at random."""
    random, size = np.random.default_rng(seed), len(model.state_space)
    dynamics = JointDynamics(Dynamics(model))
    points = random.dirichlet(np.full(size, 0.5), size=7)
    values = random.normal(size=(4, size)) * 10
    return dynamics, dynamics.points(points), points, values


@given(SMALL, SEEDS)
@settings(max_examples=30)
def test_an_action_is_worth_its_reward_and_the_best_vector_after_each_observation(model, seed):
    model = model.with_discount(min(model.discount, 0.9))
    dynamics, matrix, points, values = drawn(model, seed)
    for action, (earned, after) in enumerate(parts(model)):
        found = choose(dynamics, action, matrix, values).values
        expected = [
            belief @ earned + model.discount * sum((values @ (belief @ joint)).max() for joint in after)
            for belief in points
        ]
        np.testing.assert_allclose(found, expected, atol=1e-8)


@given(SMALL, SEEDS)
@settings(max_examples=30)
def test_the_vector_of_a_backup_has_the_value_of_the_best_action(model, seed):
    model = model.with_discount(min(model.discount, 0.9))
    dynamics, matrix, points, values = drawn(model, seed)
    each = np.stack([choose(dynamics, action, matrix, values).values for action in range(dynamics.num_actions)])
    vectors, actions = best(dynamics, matrix, values)
    np.testing.assert_allclose((vectors * points).sum(axis=1), each.max(axis=0), atol=1e-8)
    np.testing.assert_allclose(each[actions, np.arange(len(points))], each.max(axis=0), atol=1e-8)


@pytest.mark.parametrize("every", [False, True])
def test_no_point_loses_and_the_greatest_gain_is_told(every):
    random = np.random.default_rng(3)
    points = random.dirichlet(np.ones(4), size=30)
    old = Vectors(random.normal(size=(3, 4)), np.arange(3), np.zeros(3, dtype=np.intp))
    better = random.normal(size=(30, 4)) + 3
    asked = []

    def backup(block):
        rows = [int(np.flatnonzero((points == row).all(axis=1))[0]) for row in block]
        asked.extend(rows)
        return better[rows], np.full(len(rows), 2)

    found, change = improve(old, points, backup, np.random.default_rng(0), Limits(), every=every)
    before, after = (points @ each.values.T for each in (old, found))
    assert (after.max(axis=1) >= before.max(axis=1) - 1e-9).all()
    assert change == pytest.approx((after.max(axis=1) - before.max(axis=1)).max())
    assert change > 0
    assert len(asked) == len(set(asked))
    assert (len(asked) == 30) == every


def test_vectors_that_are_best_of_their_action_nowhere_go():
    points = np.eye(2)
    vectors = Vectors(np.array([[1.0, 0], [0, 1], [0.4, 0.4], [-1, -1]]), np.array([0, 0, 0, 1]), np.arange(4))
    assert needed(vectors, points).points.tolist() == [0, 1, 3]
