from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse
from sentences import refused

from mdm import problems
from mdm.errors import ModelError, ModelWarning
from mdm.models import MDP, POMDP
from mdm.models.digest import digest

IDENTITY = [np.eye(2), np.eye(2)]
REWARDS = [[0.0, 1.0], [2.0, 3.0]]


@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_dense_and_sparse_hold_the_same_numbers(states, actions, seed):
    random = np.random.default_rng(seed)
    transitions = random.random((actions, states, states)) * (random.random((actions, states, states)) < 0.6)
    transitions[:, :, 0] += 1e-3
    transitions /= transitions.sum(axis=2, keepdims=True)
    rewards = random.normal(size=(states, actions))
    dense = MDP(transitions, rewards, discount=0.9, sparse=False)
    thin = MDP([sparse.csr_array(t) for t in transitions], rewards, discount=0.9, sparse=True)
    assert not dense.is_sparse
    assert thin.is_sparse
    for action in range(actions):
        np.testing.assert_allclose(thin.transition_matrix(action).toarray(), dense.transition_matrix(action))
        np.testing.assert_allclose(dense.transition_matrix(action), transitions[action], atol=1e-12)


def test_large_models_are_sparse_unless_told_otherwise():
    size = 1100
    model = MDP([sparse.identity(size, format="csr")], np.zeros((size, 1)), discount=0.9)
    assert model.is_sparse
    assert not MDP(np.eye(3)[None], np.zeros((3, 1)), discount=0.9).is_sparse


def test_names_select_matrices():
    model = MDP([np.eye(2), np.full((2, 2), 0.5)], REWARDS, discount=1, actions=["stay", "jump"])
    assert model.transition_matrix("jump")[0, 1] == 0.5
    assert model.num_agents == 1
    assert model.kind == "MDP"


def test_rows_that_are_almost_right_are_normalised_with_a_warning():
    with pytest.warns(ModelWarning, match="1 rows of T"):
        model = MDP([[[0.50001, 0.5], [0, 1]], np.eye(2)], REWARDS, discount=0.9)
    assert model.transition_matrix(0).sum(axis=1) == pytest.approx([1, 1], abs=1e-15)


def test_arrays_cannot_be_changed():
    model = MDP(IDENTITY, REWARDS, discount=0.9)
    for array in (model.rewards, model.transition_matrix(0), model.initial_belief):
        with refused(ValueError):
            array[0] = 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transitions": [np.eye(2)]}, "T is given for 1 actions, but the model has 2"),
        ({"transitions": [np.eye(2), np.eye(3)]}, "T of action '1' is 3x3"),
        ({"transitions": [np.eye(2), [[0.5, 0.4], [0, 1]]]}, r"T of action '1': the row of '0' sums to 0.9"),
        ({"transitions": [np.eye(2), [[1.5, -0.5], [0, 1]]]}, r"-0.5 in the row of '0' is not a probability"),
        ({"transitions": [np.eye(2), [[np.nan, 1], [0, 1]]]}, "nan in the row of '0'"),
        ({"rewards": [[0, np.inf], [0, 0]]}, "reward of action '1' in state '0' is inf"),
        ({"rewards": [[[0, 1]]]}, "actions x states x states"),
        ({"discount": 0}, "discount"),
        ({"discount": 1.01}, "not 1.01"),
        ({"discount": "x"}, "at most 1, not 'x'"),
        ({"discount": True}, "at most 1, not True"),
        ({"initial_belief": [0.5, 0.6]}, "the initial belief sums to 1.1"),
        ({"initial_belief": [1.0]}, "needs 2 numbers"),
        ({"states": ["a", "b", "c"]}, "for 2 states and 2 actions, but there are 3 and 2"),
    ],
)
def test_wrong_models_are_refused_with_the_culprit(change, message):
    arguments = {"transitions": IDENTITY, "rewards": REWARDS, "discount": 0.9} | change
    with pytest.raises(ModelError, match=message):
        MDP(**arguments)


def test_another_discount_leaves_the_model_as_it_was():
    model = MDP(IDENTITY, REWARDS, discount=0.9)
    assert (model.with_discount(0.5).discount, model.discount) == (0.5, 0.9)
    with refused(ModelError):
        model.with_discount(2)


def test_a_model_says_itself_what_it_has():
    mdp, pomdp, factored = MDP(IDENTITY, REWARDS, discount=0.9), problems.tiger(), problems.tag()
    mixed = factored.revealed()
    assert [model.pomdp for model in (mdp, pomdp, mixed)] == [None, pomdp, mixed]
    assert [model.network is None for model in (mdp, pomdp, factored)] == [True, True, False]
    assert [model.observed for model in (mdp, pomdp, factored, mixed)] == [(), (), (), (0,)]
    assert (mdp.observation_space, mdp.event_observations, mdp.revealed(), mdp.step_by_step()) == (
        None,
        False,
        mdp,
        mdp,
    )
    # What is not observed of a state has one group and one row of the layout.
    assert (pomdp.seen_in.tolist(), pomdp.layout.tolist()) == ([0, 0], [[0, 1]])
    rows, columns = mixed.layout.shape
    assert (rows * columns, len(set(mixed.seen_in))) == (len(mixed.state_space), rows)


@pytest.mark.parametrize("sparse", [False, True])
def test_the_size_of_matrices_is_that_of_what_they_hold(sparse):
    random = np.random.default_rng(4)
    seen = random.dirichlet(np.ones(3), size=(2, 6))
    moved = random.dirichlet(np.ones(6), size=(2, 6))
    size = POMDP(moved, seen, np.zeros((6, 2)), discount=0.9, sparse=sparse).matrix_size
    numbers = 8 * (moved.size + seen.size)
    assert size.rewards == 8 * 12
    assert (size.kinds, size.entries, size.seen) == (2, 36, 18)
    assert size.transitions + size.observations == numbers + (numbers // 2 + 4 * 4 * 7 if sparse else 0)
    assert MDP(moved, np.zeros((6, 2)), discount=0.9, sparse=sparse).matrix_size.observations == 0


@settings(max_examples=30)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_axes_may_be_in_either_order(states, actions, seed):
    random = np.random.default_rng(seed)
    transitions = random.dirichlet(np.ones(states), size=(actions, states))
    outcomes = random.normal(size=(actions, states, states))
    expected = MDP(transitions, outcomes, discount=0.9)
    for order, turn in (("ASS", lambda array: array), ("SAS", lambda array: np.swapaxes(array, 0, 1))):
        for rewards in (turn(outcomes), turn(outcomes).tolist(), expected.rewards):
            for given_transitions in (turn(transitions), turn(transitions).tolist(), list(transitions)):
                model = MDP.from_arrays(given_transitions, rewards, order=order, discount=0.9)
                assert digest(model) == digest(expected)


def test_observations_follow_the_order_of_axes():
    seen = np.array([[[0.9, 0.1], [0.2, 0.8]], [[0.5, 0.5], [1, 0]]])
    arrays = np.eye(2)[None].repeat(2, axis=0), seen, np.zeros((2, 2))
    turned = [array.swapaxes(0, 1) if array.ndim == 3 else array for array in arrays]
    model = POMDP.from_arrays(*turned, order="SAS", discount=0.9)
    assert digest(model) == digest(POMDP(*arrays, discount=0.9))
    with refused(ModelError):
        POMDP.from_arrays(*arrays, order="SSA", discount=0.9)
    with refused(ModelError):
        POMDP.from_arrays(*arrays, order="SAS", discount=0.9, event_observations=True)
