from __future__ import annotations

import pytest
from sentences import refused

from mdm import ModelError, solve
from mdm.problems import broadcast_channel


def test_entries():
    model = broadcast_channel()
    assert model.transition("send wait", "S10", "S11") == pytest.approx(0.9 * 0.1)
    assert model.transition("send wait", "S01", "S01") == pytest.approx(0.1)
    assert model.transition("send send", "S11", "S10") == pytest.approx(0.9 * 0.9)
    assert model.transition("wait wait", "S11", "S11") == 1
    assert model.observation("send send", "S11", "Collision No-Collision") == pytest.approx(0.9 * 0.1)
    assert model.observation("send wait", "S11", "No-Collision No-Collision") == pytest.approx(0.81)
    assert [model.reward("send wait", state) for state in model.state_space.names] == [0, 0, 1, 1]
    assert [model.reward("wait send", state) for state in model.state_space.names] == [0, 1, 0, 1]
    assert model.reward("send send", "S11") == 0
    assert model.initial_belief.tolist() == [0, 0, 0, 1]


def test_a_third_node_is_refused():
    with refused(ModelError):
        broadcast_channel((0.9, 0.1, 0.5))


@pytest.mark.parametrize(("horizon", "optimum"), [(2, 2), (3, 2.99), (4, 3.89)])
def test_published_values(horizon, optimum):
    solution = solve(broadcast_channel(), "jesp", horizon=horizon, gap=1e-9)
    assert (solution.lower, solution.upper) == pytest.approx((optimum, optimum), abs=1e-6)
