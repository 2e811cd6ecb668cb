"""The filter that suits a model."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from belief_steps import needs_numba

from mdm.beliefs import BeliefTracker, choice as belief_choice
from mdm.beliefs.choice import AdaptiveFilter, chosen_filter
from mdm.beliefs.compressed import CompressedFilter
from mdm.beliefs.dense import CompactFilter, FoldedFilter, LikelyFilter
from mdm.models import POMDP, Factor, Space


def dense_model(size, filled):
    random = np.random.default_rng(0)
    transition = random.random((1, size, size)) * (random.random((1, size, size)) < filled)
    transition[:, :, 0] += 0.01
    told = random.random((1, size, 2)) + 0.1
    return POMDP(
        transition / transition.sum(axis=2, keepdims=True),
        told / told.sum(axis=2, keepdims=True),
        np.zeros((size, 1)),
        discount=0.9,
    )


@pytest.mark.parametrize(
    ("size", "filled", "folded", "plain", "compiled"),
    [
        (20, 0.1, 4_000_000, FoldedFilter, CompactFilter),
        (150, 0.5, 4_000_000, FoldedFilter, CompactFilter),
        (150, 0.5, 0, LikelyFilter, LikelyFilter),
        (150, 0.01, 4_000_000, CompressedFilter, AdaptiveFilter),
    ],
)
@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_the_filter_suits_the_model(size, filled, folded, plain, compiled, fast, monkeypatch):
    monkeypatch.setattr(belief_choice, "FOLDED", folded)
    model = dense_model(size, filled)
    assert type(chosen_filter(model, fast=fast)) is (compiled if fast else plain)


def test_a_million_states_are_tracked_by_their_support():
    """Memory is that of the model and little more, and an update touches what the belief does."""
    from scipy.sparse import csr_array

    size = 1_000_000
    states = np.arange(size)
    rows, columns = np.repeat(states, 2), np.stack([states, (states + 1) % size], axis=1).ravel()
    moves = csr_array((np.tile([0.25, 0.75], size), (rows, columns)), shape=(size, size))
    told = csr_array((np.ones(size), (states, states % 7)), shape=(size, 7))
    start = np.zeros(size)
    start[5] = 1
    tracker = BeliefTracker(
        POMDP([moves], [told], np.zeros((size, 1)), discount=0.9, initial_belief=start, sparse=True)
    )
    assert tracker.is_sparse
    assert tracker.update(0, 6) == pytest.approx(0.75)
    assert tracker.update(0, None) == pytest.approx(1)
    found = dict(zip(*(part.tolist() for part in tracker.support), strict=True))
    assert found == pytest.approx({6: 0.25, 7: 0.75})
    assert tracker.belief[6:8].tolist() == pytest.approx([0.25, 0.75])
    assert tracker.is_sparse


def listeners(observations, actions=2):
    """Return a model of two states and many observations."""
    told = np.random.default_rng(0).dirichlet(np.ones(observations), size=(actions, 2))
    return POMDP([[[0.9, 0.1], [0.2, 0.8]]] * actions, told, np.zeros((2, actions)), discount=0.9)


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_many_observations_have_no_matrix_each(fast):
    """A team of eight that hear three sounds each has thousands of them, for each of its actions."""
    model = listeners(12_000)
    assert type(chosen_filter(model, fast=fast)) is LikelyFilter
    tracker, plain = BeliefTracker(model), np.array(model.initial_belief)
    for action, seen in ((0, 5), (1, 11_999), (0, 7)):
        plain = (plain @ model.transition_matrix(action)) * model.observation_matrix(action)[:, seen]
        assert tracker.update(action, seen) == pytest.approx(plain.sum(), rel=1e-12)
        plain /= plain.sum()
        np.testing.assert_allclose(tracker.belief, plain, atol=1e-12)


def test_observations_that_agree_with_missing_components_are_kept_up_to_a_number_in_all():
    space = Space(Factor(f"agent{agent}", 8, prefix="o") for agent in range(4))
    told = np.full((1, 1, len(space)), 1 / len(space))
    model = POMDP(np.ones((1, 1, 1)), told, np.zeros((1, 1)), discount=0.9, observation_names=space)
    tracker = BeliefTracker(model)
    tracemalloc.start()
    for first in range(8):
        for second in range(8):
            for third in range(8):
                tracker.update(0, (first, second, third, None))
                tracker.update(0, (first, second, None, third))
            tracker.update(0, (first, None, None, second))
        for _ in range(20):
            tracker.update(0, (first, None, None, None))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8e6
    assert tracker.update(0, (None, None, None, None)) == pytest.approx(1.0)


def test_small_models_are_not_compiled_where_memory_is_short():
    """The compiler takes more than a hundred megabytes."""
    program = """
import sys
import mdm
from mdm.beliefs.dense import FoldedFilter
model = mdm.problems.tiger()
tracker = mdm.BeliefTracker(model.sparingly())
assert type(tracker._filter) is FoldedFilter, tracker._filter
assert tracker.update("listen", "hear-left") == 0.5
assert "numba" not in sys.modules
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
