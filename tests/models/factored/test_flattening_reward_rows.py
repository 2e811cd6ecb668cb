"""Rewards that are computed where they are read, against R as an array."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import factored_models

from mdm.errors import ModelWarning
from mdm.models.factored.flattening import RewardRows


@given(factored_models(events=True), st.integers(0, 2**32 - 1))
def test_a_row_is_read_as_an_array_is(model, seed):
    random = np.random.default_rng(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        rewards = model.rewards
    belief = random.dirichlet(np.ones(len(rewards))) * (random.random(len(rewards)) < 0.7)
    states = random.permutation(len(rewards))[:2]
    for action, row in enumerate(rewards.T):
        computed = RewardRows(model.network)[action]
        np.testing.assert_allclose(computed.take(states), row.take(states), atol=1e-12)
        assert computed.item(int(states[0])) == pytest.approx(row.item(states[0]), abs=1e-12)
        assert computed.dot(belief).item() == pytest.approx(row.dot(belief).item(), abs=1e-12)
