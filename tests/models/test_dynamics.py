from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense, factored_models, flat_models

from mdm.models import MDP, POMDP, dynamics as forms
from mdm.models.dynamics import Dynamics, once, stacked
from mdm.models.matrices import csr
from mdm.problems import tiger

POMDPS = flat_models(kinds=("POMDP",), events=True)


def row(rows, index):
    part = slice(int(rows.starts[index]), int(rows.starts[index + 1]))
    return dict(zip(rows.columns[part].tolist(), rows.values[part].tolist(), strict=True))


def filled(array):
    return {place: value for place, value in enumerate(array.tolist()) if value}


@given(flat_models() | factored_models())
def test_rows_of_transitions_are_those_of_the_model(model):
    dynamics = Dynamics(model)
    for action, first in enumerate(dynamics.transitions.first.tolist()):
        for state in range(dynamics.num_states):
            assert row(dynamics.transitions, first + state) == filled(model.transition(action, state))


@given(POMDPS)
def test_rows_of_observations_are_those_of_the_model(model):
    dynamics = Dynamics(model)
    for action, first in enumerate(dynamics.observations.first.tolist()):
        if not model.event_observations:
            for state in range(dynamics.num_states):
                assert row(dynamics.observations, first + state) == filled(model.observation(action, state))
            continue
        entries = np.argwhere(dense(model.transition_matrix(action)))
        for entry, (before, after) in enumerate(entries.tolist()):
            found = row(dynamics.observations, first + entry)
            expected = model.observation(action, after, state=before)
            assert found.pop(dynamics.num_observations, 0) == pytest.approx(1 - expected.sum(), abs=1e-9)
            assert found == filled(expected)


@given(flat_models(), st.booleans())
def test_one_matrix_of_all_actions(model, compress):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forms, "_DENSE", 2 if compress else -1)
        dynamics = Dynamics(model)
        assert dynamics.is_dense != compress
    matrix = dense(dynamics.matrix)
    for (state, action), place in np.ndenumerate(dynamics.places):
        np.testing.assert_array_equal(matrix[place], model.transition(action, state))


@given(flat_models(), st.integers(0, 99))
def test_q_values_and_policies(model, seed):
    dynamics = Dynamics(model)
    random = np.random.default_rng(seed)
    values = random.normal(size=dynamics.num_states)
    table = dynamics.q_values(values)
    for action in range(dynamics.num_actions):
        expected = model.rewards[:, action] + model.discount * (model.transition_matrix(action) @ values)
        np.testing.assert_allclose(table[:, action], expected, atol=1e-12)
    policy = random.integers(dynamics.num_actions, size=dynamics.num_states)
    matrix, rewards = dynamics.under(policy)
    chosen = table[np.arange(dynamics.num_states), policy]
    np.testing.assert_allclose(rewards + model.discount * (matrix @ values), chosen, atol=1e-12)


@given(POMDPS)
def test_joint_probabilities(model):
    dynamics = Dynamics(model)
    size, count = dynamics.num_states, dynamics.num_observations
    for action in range(dynamics.num_actions):
        joint = dynamics.joint(action)
        pairs = joint.states * (count + 1) + joint.observations
        assert (np.diff(pairs) > 0).all()
        found = np.zeros((size, count + 1, size))
        found[joint.states, joint.observations] = dense(joint.rows)
        for observation in range(count):
            np.testing.assert_array_equal(found[:, observation], dense(model.joint_matrix(action, observation)))
        np.testing.assert_allclose(found.sum(axis=1), dense(model.transition_matrix(action)), atol=1e-9)


@given(POMDPS, st.integers(0, 99))
def test_a_step_of_beliefs(model, seed):
    dynamics = Dynamics(model)
    beliefs = np.random.default_rng(seed).dirichlet(np.ones(dynamics.num_states), size=4)
    for action in range(dynamics.num_actions):
        after = dynamics.step(action, beliefs)
        for observation in range(dynamics.num_observations):
            expected = beliefs @ dense(model.joint_matrix(action, observation))
            np.testing.assert_allclose(after[:, observation], expected, atol=1e-12)


@given(POMDPS)
def test_joint_probabilities_of_some_observations(model):
    dynamics, count = Dynamics(model), len(model.observation_space)
    for action in range(dynamics.num_actions):
        joint = dynamics.joint(action)
        some = joint.only(joint.observations < count)
        each = [dense(model.joint_matrix(action, observation)) for observation in range(count)]
        np.testing.assert_allclose(dense(some.summed()), sum(each), atol=1e-12)
        np.testing.assert_array_equal(dense(some.side_by_side(count)), np.hstack(each))


@pytest.mark.parametrize("sparse", [False, True])
def test_matrices_that_actions_share_are_kept_once(sparse):
    stay, move = np.eye(3), np.roll(np.eye(3), 1, axis=1)
    told, blind = np.eye(3), np.full((3, 3), 1 / 3)
    rewards = np.arange(12.0).reshape(3, 4)
    model = POMDP([stay, move, stay, move], [told, told, told, blind], rewards, discount=0.9, sparse=sparse)
    dynamics = Dynamics(model)
    assert dynamics.transitions.first.tolist() == [0, 3, 0, 3]
    assert dynamics.observations.first.tolist() == [0, 0, 0, 3]
    assert len(dynamics.transitions.values) == 6
    assert dynamics.matrix.shape == (6, 3)
    values = np.array([1.0, 2.0, 3.0])
    assert dynamics.after(values).tolist() == [[1, 2, 1, 2], [2, 3, 2, 3], [3, 1, 3, 1]]
    assert once([stay, move, stay], id) == [id(stay), id(move), id(stay)]


def test_matrices_of_different_heights():
    rows = stacked([csr(np.eye(2)), np.array([[0.0, 0.5], [0.25, 0], [0, 0]])])
    assert rows.first.tolist() == [0, 2]
    assert rows.starts.tolist() == [0, 1, 2, 3, 4, 4]
    np.testing.assert_array_equal(dense(rows.matrix(2)), [[1, 0], [0, 1], [0, 0.5], [0.25, 0], [0, 0]])


def test_sizes():
    dynamics = Dynamics(tiger())
    assert (dynamics.num_states, dynamics.num_actions, dynamics.num_observations) == (2, 3, 2)
    assert Dynamics(MDP([np.eye(2)], [[0.0], [1.0]], discount=0.5)).num_observations == 0
