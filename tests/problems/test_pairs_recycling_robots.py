from __future__ import annotations

import pytest

from mdm import solve
from mdm.problems import recycling_robots


def test_entries():
    model = recycling_robots()
    assert model.transition("searchlittle searchbig", "low high", "low low") == pytest.approx(0.8 * 0.5)
    assert model.transition("waitandrecharge waitandrecharge", "low low", "high high") == 1
    assert model.observation("searchbig searchbig", "high low", "high low") == 1
    assert model.initial_belief.tolist() == [1, 0, 0, 0]


def test_rewards():
    model = recycling_robots()
    assert model.reward("searchlittle searchlittle", "high high") == pytest.approx(4)
    assert model.reward("searchbig searchbig", "high high") == 5
    assert model.reward("searchbig waitandrecharge", "high high") == 0
    assert model.reward("waitandrecharge searchlittle", "high low") == pytest.approx(0.8 * 2 - 0.2 * 10)
    assert model.reward("searchbig searchbig", "low low") == pytest.approx(0.49 * 5 - 0.42 * 10 - 0.09 * 20)


@pytest.mark.parametrize(("horizon", "optimum"), [(2, 7), (3, 10.660125), (4, 13.38)])
def test_published_values(horizon, optimum):
    solution = solve(recycling_robots(discount=1.0), "jesp", horizon=horizon, gap=1e-9)
    assert (solution.lower, solution.upper) == pytest.approx((optimum, optimum), abs=1e-6)
