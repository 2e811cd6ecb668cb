from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import flat_models

from mdm.compilation import can_compile
from mdm.models import dynamics as forms
from mdm.models.dynamics import Dynamics
from mdm.solvers.mdp import value_iteration as backups
from mdm.solvers.mdp.value_iteration import backup, kernels, sweep


@pytest.mark.compiled("sweeps", where_possible=True)
@given(model=flat_models(), seed=st.integers(0, 99), each=st.integers(1, 4))
def test_compiled_or_not(model, seed, each):
    model = model.with_discount(0.9)
    size = len(model.state_space)
    values = np.random.default_rng(seed).normal(size=size)
    results = []
    for compiled in (False, can_compile()):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(backups, "can_compile", lambda compiled=compiled: compiled)
            patch.setattr(forms, "_DENSE", 2)  # all are CSR
            dynamics = Dynamics(model)
            assert (kernels(dynamics) is not None) == compiled
            backed, policy = backup(dynamics, values)
            np.testing.assert_allclose(backed, dynamics.q_values(values).max(axis=1), atol=1e-12)
            np.testing.assert_allclose(dynamics.q_values(values)[np.arange(size), policy], backed, atol=1e-12)
            swept = np.full(size, -np.abs(model.rewards).max() * 10)  # below all values, so that sweeps raise it
            sweep(dynamics, swept, policy, 2000, each, 0.0)
            np.testing.assert_allclose(backup(dynamics, swept)[0], swept, atol=1e-9)
        results.append((backed, swept))
    np.testing.assert_allclose(*results, atol=1e-9)
