from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense, flat_models

from mdm.models.compilation import can_compile
from mdm.solvers.mdp import stack
from mdm.solvers.mdp.stack import Stack


@given(flat_models())
def test_rows_are_those_of_states_and_their_actions(model):
    found = Stack(model)
    count = len(model.action_space)
    for state in range(len(model.state_space)):
        for action in range(count):
            np.testing.assert_array_equal(
                dense(found.matrix)[state * count + action], dense(model.transition_matrix(action))[state]
            )


@given(model=flat_models(), seed=st.integers(0, 99), each=st.integers(1, 4))
def test_compiled_or_not(model, seed, each):
    model = model.with_discount(0.9)
    values = np.random.default_rng(seed).normal(size=len(model.state_space))
    results = []
    for compiled in (False, can_compile()):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(stack, "can_compile", lambda compiled=compiled: compiled)
            patch.setattr(stack, "_DENSE", 2)  # all are CSR
            found = Stack(model)
        assert (found.kernels is not None) == compiled
        backed, policy = found.backup(values)
        np.testing.assert_allclose(backed, found.q_values(values).max(axis=1), atol=1e-12)
        np.testing.assert_allclose(found.q_values(values)[np.arange(found.size), policy], backed, atol=1e-12)
        swept = np.full(found.size, -np.abs(model.rewards).max() * 10)  # below all values, so that sweeps raise it
        found.sweep(swept, policy, 2000, each, 0.0)
        np.testing.assert_allclose(found.backup(swept)[0], swept, atol=1e-9)
        results.append((backed, swept))
    np.testing.assert_allclose(*results, atol=1e-9)
