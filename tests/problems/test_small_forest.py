from __future__ import annotations

import numpy as np
import pytest

from mdm import ModelError, solve
from mdm.problems import forest


def test_the_published_example():
    model = forest()
    assert model.transition_matrix("wait").tolist() == [[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]]
    assert model.transition_matrix("cut").tolist() == [[1, 0, 0]] * 3
    assert model.rewards.tolist() == [[0, 0], [0, 1], [4, 2]]
    solution = solve(model)
    assert [solution.policy.value(state) for state in range(3)] == pytest.approx([26.244, 29.484, 33.484], abs=1e-2)
    assert [solution.policy.action(state) for state in range(3)] == [0, 0, 0]


def test_any_size():
    model = forest(50, fire=0.2)
    assert len(model.state_space) == 50
    assert model.transition("wait", "age-49", "age-49") == 0.8
    assert np.flatnonzero(model.rewards[:, 1]).tolist() == list(range(1, 50))


@pytest.mark.parametrize(
    ("settings", "words"), [({"ages": 1}, "two classes"), ({"fire": -0.5}, "fire is a probability, not -0.5")]
)
def test_wrong_settings(settings, words):
    with pytest.raises(ModelError, match=words):
        forest(**settings)
