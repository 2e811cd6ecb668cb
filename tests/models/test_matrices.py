from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from mdm.errors import ModelError
from mdm.models import MDP, POMDP
from mdm.models.matrices import distribution

REWARDS = np.zeros((2, 2))
SWAP = np.array([[0.0, 1.0], [1.0, 0.0]])


class Lazy:
    """A sequence that makes each matrix when it is asked for, so that their addresses may be the same."""

    def __len__(self):
        return 2

    def __getitem__(self, action):
        if action > 1:
            raise IndexError(action)
        return np.eye(2) if action == 0 else SWAP.copy()


def test_matrices_made_on_demand_are_not_taken_for_one_another():
    model = MDP(Lazy(), REWARDS, discount=0.9)
    np.testing.assert_array_equal(model.transition_matrix(0), np.eye(2))
    np.testing.assert_array_equal(model.transition_matrix(1), SWAP)


def test_one_matrix_for_several_actions_is_kept_once():
    shared = np.eye(2)
    model = MDP([shared, shared], REWARDS, discount=0.9)
    assert model.transition_matrix(0) is model.transition_matrix(1)
    assert shared.flags.writeable


@pytest.mark.parametrize("given", [[["a", "b"]] * 2, [[1.0], [0.0, 1.0]], [[None, {}], [0, 1]]])
def test_what_is_no_array_of_numbers_is_refused(given):
    with pytest.raises(ModelError, match="T of action '0' is not an array of numbers"):
        MDP([given, given], REWARDS, discount=0.9)
    with pytest.raises(ModelError, match="first matrix of observations is not an array of numbers"):
        POMDP([np.eye(2)] * 2, [given, given], REWARDS, discount=0.9)


@pytest.mark.parametrize("given", [[], [[]], [1, 1], [[[]], [[]]], np.zeros((2, 2, 0))])
def test_observations_need_two_dimensions(given):
    with pytest.raises(ModelError, match="observations are an actions x states x observations array"):
        POMDP([np.eye(2)] * 2, given, REWARDS, discount=0.9)


@pytest.mark.parametrize("given", [["a", "b"], [[0.5], [0.25, 0.25]], [{}, 1]])
def test_a_distribution_is_numbers(given):
    with pytest.raises(ModelError, match="the belief is not an array of numbers"):
        distribution(given, what="the belief", size=2)


@pytest.mark.parametrize(("density", "thin"), [(0.01, True), (0.9, False)])
@pytest.mark.parametrize("as_csr", [True, False])
def test_size_and_density_choose_whatever_the_form(density, thin, as_csr):
    random = np.random.default_rng(1)
    matrix = random.random((1001, 1001)) * (random.random((1001, 1001)) < density) + np.eye(1001)
    matrix /= matrix.sum(axis=1, keepdims=True)
    model = MDP([sparse.csr_array(matrix) if as_csr else matrix], np.zeros((1001, 1)), discount=0.9)
    assert model.is_sparse is thin
