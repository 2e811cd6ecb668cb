from __future__ import annotations

import pytest

from mdm import solve
from mdm.problems import dec_tiger


def test_entries():
    model = dec_tiger()
    assert model.observation("listen listen", "tiger-left", "hear-left hear-right") == pytest.approx(0.85 * 0.15)
    assert model.observation("listen open-left", "tiger-left").tolist() == [0.25] * 4
    assert model.transition("listen listen", "tiger-right").tolist() == [0, 1]
    assert model.transition("open-left listen", "tiger-right").tolist() == [0.5, 0.5]
    assert model.reward("open-left open-left", "tiger-left") == -50
    assert model.reward("open-right listen", "tiger-left") == 10 - 1
    assert model.reward("listen open-right", "tiger-right") == -100 - 1


def test_parameters():
    model = dec_tiger(1.0, left=0.8)
    assert model.initial_belief.tolist() == [0.8, pytest.approx(0.2)]
    assert model.observation("listen listen", "tiger-right").tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize(("horizon", "optimum"), [(2, -4), (3, 5.190812), (4, 4.802755)])
def test_published_values(horizon, optimum):
    solution = solve(dec_tiger(), "jesp", horizon=horizon, gap=1e-9)
    assert solution.lower == pytest.approx(optimum, abs=1e-6)
    assert solution.upper == pytest.approx(optimum, abs=1e-6)
