"""What an action earns before anything is detected."""

from __future__ import annotations

import numpy as np
import pytest

from mdm.models import POMDP
from mdm.solvers import Limits, joint_dynamics
from mdm.solvers.perseus import perseus


@pytest.mark.parametrize("sparse", [False, True])
def test_what_is_never_detected_goes_on(monkeypatch, sparse):
    monkeypatch.setattr(joint_dynamics, "_SMALL", 0 if sparse else 10**9)
    monkeypatch.setattr(joint_dynamics, "_DENSE", 2.0)
    model = POMDP([np.eye(2)] * 2, [np.array([[1, 0], [1, 0]])] * 2, [[1, 2], [3, 1]], discount=0.5, sparse=sparse)
    model = model.with_false_negatives(0)
    for horizon in (None, 1, 2):
        solution = perseus(model, beliefs=20, horizon=horizon, limits=Limits(gap=0))
        assert solution.lower == pytest.approx(4, abs=1e-5)  # the first for ever, 2 a step
        assert solution.upper == pytest.approx(4, abs=1e-5)
