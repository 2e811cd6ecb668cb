"""Steps of a belief filter, compared with sums over all states."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from mdm.beliefs import Support, dense as compact
from mdm.beliefs.choice import AdaptiveFilter
from mdm.beliefs.compressed import GroupedFilter
from mdm.beliefs.dense import CompactFilter, LikelyFilter
from mdm.beliefs.support import CompiledSupportFilter
from mdm.models import POMDP
from mdm.models.dynamics import Dynamics


def loaded(filter_, belief):
    belief = np.asarray(belief)
    (states,) = belief.nonzero()
    filter_.load(Support(states, belief[states]))
    return filter_


def assert_step(filter_, expected, probability):
    """Compare with the next belief, not normalised; return it normalised, or None where it is impossible."""
    total = expected.sum()
    assert probability == pytest.approx(total, abs=1e-12)
    if not total > 0:
        return None
    belief = expected / total
    np.testing.assert_allclose(filter_.dense(), belief, atol=1e-12)
    states, probabilities = filter_.support()
    again = np.zeros(len(belief))
    again[states] = probabilities
    np.testing.assert_allclose(again, belief, atol=1e-12)
    assert (probabilities > 0).all()
    assert len(np.unique(states)) == len(states)
    return belief


needs_numba = pytest.mark.compiled("beliefs")


def corridor(size, observations=3):
    """A walk in a ring by 1, 2 or 3 places, whose last observation tells that the state is one of four."""
    random = np.random.default_rng(size)
    rows = np.repeat(np.arange(size), 3)
    columns = (rows + np.tile([1, 2, 3], size)) % size
    weights = random.random(3 * size) + 0.1
    transition = np.zeros((size, size))
    transition[rows, columns] = weights
    transition /= transition.sum(axis=1, keepdims=True)
    told = random.random((size, observations)) + 0.1
    told[:, -1] = 0
    told[:4, -1] = 5
    told /= told.sum(axis=1, keepdims=True)
    return POMDP([transition], [told], np.zeros((size, 1)), discount=0.9, initial_belief=np.eye(size)[0], sparse=True)


def track(model: POMDP, seed: int) -> None:
    """Step every compiled belief filter."""
    dynamics = Dynamics(model)
    filters = [CompactFilter(dynamics.model), GroupedFilter(dynamics), CompiledSupportFilter(dynamics)]
    with patch.object(compact, "_SPARSE", 2):
        filters.append(CompactFilter(dynamics.model))
    filters.append(AdaptiveFilter(CompiledSupportFilter(dynamics), GroupedFilter(dynamics), 2, 2))
    if not dynamics.model.event_observations:
        filters.append(LikelyFilter(dynamics.model, fast=True))
    for each in filters:
        random = np.random.default_rng(seed)
        (states,) = model.initial_belief.nonzero()
        each.load(Support(states, model.initial_belief[states]))
        for _ in range(6):
            action = int(random.integers(dynamics.num_actions))
            if not each.step(action, int(random.integers(dynamics.num_observations))) > 0:
                each.predict(action)
            each.dense()
