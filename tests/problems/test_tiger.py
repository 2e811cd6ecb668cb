from __future__ import annotations

import pytest
from sentences import refused

from mdm import ModelError, solve
from mdm.problems import tiger


def test_entries():
    model = tiger()
    assert model.observation("listen", "tiger-left", "hear-left") == 0.85
    assert model.observation("open-left", "tiger-left", "hear-left") == 0.5
    assert model.transition("open-right", "tiger-left").tolist() == [0.5, 0.5]
    assert model.transition("listen", "tiger-right").tolist() == [0, 1]
    assert model.rewards.tolist() == [[-1, -100, 10], [-1, 10, -100]]
    assert model.initial_belief.tolist() == [0.5, 0.5]


@pytest.mark.parametrize(("discount", "value"), [(0.95, 19.3713), (0.75, 1.9334)])
def test_published_values(discount, value):
    solution = solve(tiger(discount=discount), gap=1e-3)
    assert solution.lower - 1e-4 <= value <= solution.upper + 1e-4
    assert solution.upper - solution.lower <= 1e-3


def test_the_accuracy_is_a_probability():
    with refused(ModelError):
        tiger(2)
