"""A belief's support, and where it becomes too large or small again."""

from __future__ import annotations

import numpy as np
import pytest
from belief_steps import assert_step, corridor, loaded, needs_numba
from random_models import dense

from mdm.beliefs import Support, choice as belief_choice
from mdm.beliefs.choice import AdaptiveFilter, chosen_filter
from mdm.beliefs.compressed import CompressedFilter, GroupedFilter
from mdm.beliefs.support import CompiledSupportFilter, SupportFilter
from mdm.models import POMDP
from mdm.models.dynamics import Dynamics


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_the_support_grows_and_shrinks_and_grows_again(fast, monkeypatch):
    monkeypatch.setattr(belief_choice, "_GATHERED", (0, 8))
    size = 240
    model = corridor(size)
    filter_ = chosen_filter(model, fast=fast)
    transition, told = dense(model.transition_matrix(0)), dense(model.observation_matrix(0))
    belief = model.initial_belief
    loaded(filter_, belief)
    kinds = []
    for step in range(120):
        observation = 2 if step % 60 == 59 else step % 2
        if observation == 2:
            # a belief in which the four states have a part, whatever the walk
            belief = (belief + np.eye(size)[:8].sum(axis=0) / 8) / 2
            loaded(filter_, belief)
        belief = assert_step(filter_, belief @ transition * told[:, observation], filter_.step(0, observation))
        kinds.append(filter_.is_sparse)
        if kinds[-1]:
            assert np.count_nonzero(belief) <= size // 8
        else:
            assert np.count_nonzero(belief) >= size // 16
    assert kinds[0]
    assert not kinds[58]
    assert kinds[59]
    assert not kinds[-2]
    assert kinds[-1]


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=needs_numba)])
def test_a_belief_between_the_two_bounds_is_held_as_it_was(fast):
    told = np.zeros((64, 3))
    told[:3, 0] = told[3:9, 1] = told[9:, 2] = 1
    dynamics = Dynamics(POMDP([np.eye(64)], [told], np.zeros((64, 1)), discount=0.9, sparse=True))
    narrow, wide = (CompiledSupportFilter, GroupedFilter) if fast else (SupportFilter, CompressedFilter)
    filter_ = AdaptiveFilter(narrow(dynamics), wide(dynamics), 8, 4)
    for states, observation, sparse_before, sparse in (
        (8, 1, True, True),  # 5 states are left
        (9, 1, False, False),  # 6 states are left
        (9, 0, False, True),  # 3 states are left
    ):
        filter_.load(Support(np.arange(states), np.full(states, 1 / states)))
        assert filter_.is_sparse == sparse_before
        filter_.step(0, observation)
        assert filter_.is_sparse == sparse
