"""Lengths of actions, against exact moments."""

from __future__ import annotations

import numpy as np
import pytest

import mdm
from mdm.models import Durations
from mdm.simulation.sampler import Lengths


def test_lengths_have_the_moments_of_erlang_distributions():
    model = mdm.problems.forest()
    lengths = Lengths(model, Durations([[1.0, 6.0], [2.0, 6.0], [3.0, 6.0]], [1, 9]), seed=1)
    for state, action, mean, stages in ((0, 0, 1.0, 1), (2, 0, 3.0, 1), (1, 1, 6.0, 9)):
        drawn = np.array([lengths.draw(state, action) for _ in range(40_000)])
        assert drawn.mean() == pytest.approx(mean, rel=0.02)
        assert drawn.std() == pytest.approx(mean / stages**0.5, rel=0.03)
        assert drawn.min() > 0


def test_the_same_seed_gives_the_same_lengths():
    model = mdm.problems.forest()
    one, other = (Lengths(model, Durations(2.0), seed=3) for _ in range(2))
    assert [one.draw(0, 0) for _ in range(5)] == [other.draw(0, 0) for _ in range(5)]
