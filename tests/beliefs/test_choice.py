"""The filter that suits a model."""

from __future__ import annotations

import numpy as np
import pytest

from mdm.beliefs import BeliefTracker, choice as belief_choice
from mdm.beliefs.adaptive import AdaptiveFilter
from mdm.beliefs.choice import chosen_filter
from mdm.beliefs.compact import CompactFilter
from mdm.beliefs.compressed import CompressedFilter
from mdm.beliefs.dense import FoldedFilter, LikelyFilter
from mdm.models import POMDP
from mdm.models.compilation import can_compile


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
def test_the_filter_suits_the_model(size, filled, folded, plain, compiled, monkeypatch):
    monkeypatch.setattr(belief_choice, "_FOLDED", folded)
    model = dense_model(size, filled)
    assert type(chosen_filter(model, fast=False)) is plain
    if can_compile():
        assert type(chosen_filter(model, fast=True)) is compiled


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
