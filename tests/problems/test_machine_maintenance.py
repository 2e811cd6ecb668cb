from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import ModelError
from mdm.problems import machine_maintenance


def test_entries():
    model = machine_maintenance(2)
    assert (len(model.state_space), len(model.action_space), len(model.observation_space)) == (16, 4, 4)
    assert model.transition("manufacture", "good good", "good fair") == pytest.approx(0.97 * 0.03)
    assert model.transition("manufacture", "broken good", "broken good") == pytest.approx(0.97)
    assert model.transition("repair", "fair broken", "good broken") == pytest.approx(0.8)
    assert model.transition("replace", "poor broken", "good good") == 1
    assert model.transition("inspect", "poor fair", "poor fair") == 1
    assert model.observation("manufacture", "poor fair").tolist() == pytest.approx([1 - 0.75 * 0.95, 0, 0, 0.75 * 0.95])
    assert model.observation("inspect", "poor good", "good bad") == pytest.approx(0.05 * 0.03)
    assert model.observation("repair", "good good", "bad bad") == 1
    assert model.reward("manufacture", "good good") == pytest.approx((0.97 + 0.03 * 0.95) ** 2)
    assert model.rewards[:, 1:].tolist() == [[-1, -3, -15]] * 16
    assert model.initial_belief.tolist() == np.eye(16)[-1].tolist()


def test_published_sizes():
    model = machine_maintenance()
    assert (len(model.state_space), len(model.action_space), len(model.observation_space)) == (256, 4, 16)


def test_a_machine_has_components():
    with refused(ModelError):
        machine_maintenance(0)
