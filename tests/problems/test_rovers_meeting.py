from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import solve
from mdm.errors import ModelError
from mdm.problems import grid_small, meeting


def test_steps():
    model = meeting(3)
    assert model.transition("up stay", "cell4 cell4", "cell1 cell4") == pytest.approx(0.6)
    assert model.transition("up stay", "cell4 cell4", "cell3 cell4") == pytest.approx(0.1)
    assert model.transition("up stay", "cell4 cell4", "cell4 cell4") == pytest.approx(0.1)
    assert model.transition("left left", "cell0 cell1", "cell0 cell0") == pytest.approx(0.8 * 0.6)
    assert model.transition("stay stay", "cell2 cell7", "cell2 cell7") == 1


def test_meeting_in_corners():
    model = meeting(3)
    together = model.rewards[:, 0].reshape(9, 9)
    assert np.argwhere(together).tolist() == [[0, 0], [8, 8]]
    assert (model.rewards == model.rewards[:, :1]).all()
    assert model.initial_belief[model.state_space.index("cell2 cell6")] == 1
    assert model.observation("up up", "cell5 cell1", "obs5 obs1") == 1


def test_small_grid():
    model = grid_small()
    assert model.reward("stay stay", "cell1 cell1") == 1
    assert model.reward("left stay", "cell1 cell0") == pytest.approx(0.6)
    assert model.reward("left up", "cell1 cell2") == pytest.approx(0.6 * 0.6 + 0.1 * 0.1)  # upper left, lower right
    assert model.observation("stay stay", "cell2 cell3").tolist() == [0, 1, 0, 0]
    assert model.initial_belief[model.state_space.index("cell1 cell2")] == 1


@pytest.mark.parametrize(
    ("problem", "horizon", "optimum"),
    [
        (grid_small, 2, 0.91),
        (grid_small, 3, 1.550444),
        (meeting, 2, 0),
        (meeting, 3, 0.1332),
    ],
)
def test_published_values(problem, horizon, optimum):
    solution = solve(problem().with_discount(1.0), "jesp", horizon=horizon, gap=1e-9)
    assert (solution.lower, solution.upper) == pytest.approx((optimum, optimum), abs=1e-6)


def test_sizes():
    model = meeting(8)
    assert (len(model.state_space), len(model.observation_space)) == (4096, 4096)
    assert model.is_sparse
    assert model.transition("down right", "cell7 cell56", "cell15 cell57") == pytest.approx(0.36)
    with refused(ModelError):
        meeting(1)
