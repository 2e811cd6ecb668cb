"""Dense and sparse dynamics are the same."""

from __future__ import annotations

import numpy as np
from perseus_models import events

from mdm.solvers import Limits, joint_dynamics
from mdm.solvers.perseus import perseus


def test_sparse_and_dense_find_the_same(monkeypatch):
    model = events(7, told=0.95, size=9)
    found = []
    for small, wide in ((10**9, 10**9), (0, 10**9), (0, 0)):
        monkeypatch.setattr(joint_dynamics, "_SMALL", small)
        monkeypatch.setattr(joint_dynamics, "_DENSE", 2.0)
        monkeypatch.setattr(joint_dynamics, "_WIDE", wide)
        monkeypatch.setattr(joint_dynamics, "_NARROW", 2.0)
        for missed in (None, 2):
            limits = Limits(iterations=5, gap=0)
            found.append(perseus(model.with_false_negatives(missed), beliefs=40, limits=limits).lower)
    np.testing.assert_allclose(found[2:4], found[:2], atol=1e-9)
    np.testing.assert_allclose(found[4:], found[:2], atol=1e-9)
