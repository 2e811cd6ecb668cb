from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import ModelError, solve
from mdm.problems import river_swim


def test_entries():
    model = river_swim()
    assert model.transition("right", "place-0").tolist() == [0.7, 0.3, 0, 0, 0, 0]
    assert model.transition("right", "place-3").tolist() == [0, 0, 0.1, 0.6, 0.3, 0]
    assert model.transition("right", "place-5").tolist() == [0, 0, 0, 0, 0.7, 0.3]
    assert model.transition("left", "place-5", "place-4") == 1
    assert model.reward("right", "place-5", "place-5") == 10_000
    assert model.reward("right", "place-5") == 3000
    assert model.reward("left", "place-0") == 5
    assert model.initial_belief.tolist() == [0, 0.5, 0.5, 0, 0, 0]


def test_swimming_on_is_best():
    model = river_swim()
    ahead = model.transition_matrix("right")
    values = np.linalg.solve(np.eye(6) - 0.95 * ahead, [0, 0, 0, 0, 0, 3000])
    solution = solve(model)
    assert [solution.policy.value(state) for state in range(6)] == pytest.approx(values, rel=1e-4)


def test_a_river_has_three_places():
    with refused(ModelError):
        river_swim(2)
