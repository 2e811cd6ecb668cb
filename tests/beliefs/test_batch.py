"""Beliefs of a batch of episodes, each as a tracker of its own has it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_models import dense, flat_models
from scipy import sparse

from mdm.beliefs import BeliefTracker
from mdm.beliefs.batch import BatchTracker, grouped, product


@given(flat_models(kinds=("POMDP",), events=True, finer=False), st.data())
@settings(max_examples=30)
def test_each_row_is_as_a_tracker_of_its_own(model, data):
    actions, observations = len(model.action_space), len(model.observation_space)
    if observations > 1 and data.draw(st.booleans()):
        model = model.with_false_negatives(data.draw(st.integers(0, observations - 1)))
    batch, alone = BatchTracker(model), [BeliefTracker(model) for _ in range(5)]
    batch.begin(np.zeros(5, dtype=int))
    for _ in range(data.draw(st.integers(1, 4))):
        acts = np.array(data.draw(st.lists(st.integers(0, actions - 1), min_size=5, max_size=5)))
        seen = np.array(data.draw(st.lists(st.integers(0, observations - 1), min_size=5, max_size=5)))
        episodes = np.array(data.draw(st.lists(st.integers(0, 4), min_size=1, max_size=5, unique=True)))
        before = batch.beliefs.copy()
        batch.update(episodes, acts[episodes], seen[episodes])
        for row, tracker in enumerate(alone):
            if row not in episodes:
                np.testing.assert_array_equal(batch.beliefs[row], before[row])
            elif not tracker.update(int(acts[row]), int(seen[row])) > 0:
                tracker.update(int(acts[row]), None)  # which is impossible: time passes, and nothing was seen
            np.testing.assert_allclose(batch.beliefs[row], tracker.belief, atol=1e-9)
    batch.keep(np.array([3, 1]))
    np.testing.assert_allclose(batch.beliefs, [alone[3].belief, alone[1].belief], atol=1e-9)


@pytest.mark.parametrize("size", [3, 700])
def test_products_in_parts_are_products(size):
    random = np.random.default_rng(size)
    rows, matrix = random.random((5, size)), random.random((size, size)) * (random.random((size, size)) < 0.1)
    np.testing.assert_allclose(product(rows, matrix), rows @ matrix)
    np.testing.assert_allclose(product(rows, sparse.csr_array(matrix)), rows @ dense(matrix))


@given(st.lists(st.integers(0, 4), min_size=1, max_size=12))
def test_groups_are_of_equal_keys(keys):
    found = {key: where.tolist() for where, key in grouped(np.array(keys))}
    assert found == {key: [at for at, other in enumerate(keys) if other == key] for key in set(keys)}
