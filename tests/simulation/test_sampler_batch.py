from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_models import dense, distributions

from mdm.models import MDP
from mdm.models.dynamics import Dynamics, stacked
from mdm.simulation.sampler import Draws, ended_states


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=30)
def test_draws_follow_their_rows_and_never_leave_them(seed, shared):
    from scipy import sparse

    random = np.random.default_rng(seed)
    matrices = [distributions(random, 3, 7), sparse.csr_array(distributions(random, 3, 7))]
    if shared:
        matrices.append(matrices[0])
    draws = Draws(stacked(matrices))
    for which, matrix in enumerate(matrices):
        for row in range(3):
            probabilities = dense(matrix)[row]
            numbers = np.concatenate([(np.arange(2000) + 0.5) / 2000, [0.0, np.nextafter(1, 0)]])
            at = np.full(len(numbers), which), np.full(len(numbers), row)
            drawn = draws.columns[draws(*at, numbers)]
            assert (probabilities[drawn] > 0).all()
            assert (np.diff(drawn[:2000]) >= 0).all()
            counts = np.bincount(drawn[:2000], minlength=7) / 2000
            np.testing.assert_allclose(counts, probabilities, atol=1.1e-3)


@pytest.mark.parametrize("sparse", [False, True])
def test_states_from_which_nothing_more_can_be_earned(sparse):
    """States 0 and 1 lead to each other for ever, 2 leads to them, and by one action to 3, which earns."""
    ring = [[0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    out = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]]
    model = MDP([ring, out], [[0, 0], [0, 0], [0, 0], [0, 1]], discount=0.9, sparse=sparse)
    assert ended_states(Dynamics(model)).tolist() == [True, True, False, False]
    assert not ended_states(Dynamics(model.with_discount(0.5)))[2:].any()
    assert ended_states(Dynamics(MDP([ring], np.zeros((4, 1)), discount=0.9))).all()
