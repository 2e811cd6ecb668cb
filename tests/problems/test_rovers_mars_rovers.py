from __future__ import annotations

import pytest

from mdm import solve
from mdm.problems import mars_rovers


def test_moves():
    model = mars_rovers()
    assert model.transition("down right", "s0 s0 no no no no", "s1 s2 no no no no") == pytest.approx(0.81)
    assert model.transition("up left", "s0 s0 no no no no", "s0 s0 no no no no") == 1
    assert model.transition("drill up", "s3 s1 no no no no", "s3 s0 yes no no no") == pytest.approx(0.9)
    assert model.transition("sample drill", "s0 s3 no yes yes no", "s0 s0 no no no no") == 1
    assert model.initial_belief[model.state_space.index("s0 s0 no no no no")] == 1


def test_observations():
    model = mars_rovers()
    assert model.observation("up up", "s2 s1 no yes no yes", "s2sampled s1notSampled") == 1


@pytest.mark.parametrize(
    ("actions", "state", "reward"),
    [
        ("up down", "s0 s0 no no no no", -0.2),
        ("drill drill", "s3 s3 no no no no", 6),
        ("drill drill", "s1 s1 no no no no", 0),
        ("sample sample", "s0 s0 no no no no", 1),
        ("sample sample", "s2 s2 no no no no", 2),
        ("sample up", "s2 s2 no no no no", 1.9),
        ("up drill", "s2 s2 no no no no", -10.1),
        ("drill up", "s2 s2 no yes no no", -1.1),
        ("sample sample", "s0 s1 no no no no", 4),
        ("sample sample", "s0 s1 no no no yes", 1),
        ("sample sample", "s0 s1 no no yes yes", -2),
        ("sample drill", "s0 s0 no no no no", 0),
    ],
)
def test_rewards(actions, state, reward):
    assert mars_rovers().reward(actions, state) == pytest.approx(reward)


@pytest.mark.parametrize(("horizon", "optimum"), [(2, 5.8), (3, 9.38)])
def test_published_values(horizon, optimum):
    solution = solve(mars_rovers(), "jesp", horizon=horizon, gap=1e-9)
    assert (solution.lower, solution.upper) == pytest.approx((optimum, optimum), abs=1e-6)
