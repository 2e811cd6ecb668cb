from __future__ import annotations

import math

import numpy as np
import pytest

from mdm import ModelError
from mdm.problems import aloha


def test_entries():
    model = aloha()
    none, one = math.exp(-0.9), 0.9 * math.exp(-0.9)
    assert model.transition("send-1/1", "0 idle", "0 idle") == pytest.approx(none)
    assert model.transition("send-1/1", "1 idle", "0 success") == pytest.approx(none)
    assert model.transition("send-1/2", "1 collision", "1 idle") == pytest.approx(none / 2)
    assert model.transition("send-1/1", "2 idle", "3 collision") == pytest.approx(one)
    assert model.transition("send-1/3", "2 idle", "1 success") == pytest.approx(2 * (1 / 3) * (2 / 3) * none)
    assert model.transition("send-1/1", "9 idle", "9 collision") == pytest.approx(1)
    assert model.reward("send-1/4", "3 success") == 6
    assert model.observation("send-1/4", "3 success", "success") == 1
    assert model.initial_belief.argmax() == 0


@pytest.mark.parametrize(("levels", "sizes"), [(10, (30, 9, 3)), (30, (90, 29, 3))])
def test_published_sizes(levels, sizes):
    model = aloha(levels)
    assert (len(model.state_space), len(model.action_space), len(model.observation_space)) == sizes
    for action in range(sizes[1]):
        np.testing.assert_allclose(model.transition_matrix(action).sum(axis=1), 1)


@pytest.mark.parametrize(("settings", "words"), [({"levels": 1}, "two levels"), ({"arrivals": -1}, "not -1")])
def test_wrong_settings(settings, words):
    with pytest.raises(ModelError, match=words):
        aloha(**settings)
