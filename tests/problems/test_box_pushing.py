from __future__ import annotations

import pytest

from mdm import solve
from mdm.problems import box_pushing


def following(model, actions, state):
    """Return the states that may follow, with their probabilities."""
    row = model.transition(actions, state)
    return {model.state_space.names[index]: round(float(row[index]), 9) for index in row.nonzero()[0]}


def test_moves():
    model = box_pushing()
    assert following(model, "turnLeft stay", "s1N4N") == {"s1W4N": 0.9, "s1N4N": 0.1}
    assert following(model, "stay moveForward", "s1E4W") == {"s1E3W": 0.9, "s1E4W": 0.1}
    assert following(model, "moveForward stay", "s1E2W") == {"s1E2W": 1}
    assert following(model, "moveForward moveForward", "s1E3W") == {"s2E3W": 0.09, "s1E2W": 0.09, "s1E3W": 0.82}


def test_boxes():
    model = box_pushing()
    assert following(model, "moveForward moveForward", "s2N3N") == {"largeBoxAtGoal": 0.81, "s2N3N": 0.19}
    assert following(model, "moveForward moveForward", "s1N4N") == {
        "bothSmallAtGoal": 0.81,
        "leftBoxAtGoal": 0.09,
        "rightBoxAtGoal": 0.09,
        "s1N4N": 0.01,
    }
    assert following(model, "turnLeft stay", "largeBoxAtGoal") == {"s1E4W": 1}
    assert following(model, "stay stay", "s2N3N") == {"s2N3N": 1}


@pytest.mark.parametrize(
    ("actions", "state", "reward"),
    [
        ("stay stay", "s1E4W", -0.2),
        ("moveForward stay", "s1N4W", 9.8),
        ("moveForward moveForward", "s1N4N", 19.8),
        ("moveForward moveForward", "s2N3N", 99.8),
        ("moveForward stay", "s2N3N", -5.2),
        ("moveForward moveForward", "s1S4E", -10.2),
        ("moveForward moveForward", "s1E3W", -10.2),
        ("moveForward moveForward", "s1E2E", -5.2),
        ("turnLeft turnRight", "rightBoxAtGoal", 0),
    ],
)
def test_rewards(actions, state, reward):
    assert box_pushing().reward(actions, state) == pytest.approx(reward)


@pytest.mark.parametrize(
    ("state", "seen"),
    [
        ("s1N3N", "smallBox largeBox"),
        ("s1E2W", "otherAgent otherAgent"),
        ("s1W4E", "wall wall"),
        ("s1S4W", "wall emptyField"),
        ("bothSmallAtGoal", "emptyField emptyField"),
    ],
)
def test_observations(state, seen):
    assert box_pushing().observation("stay stay", state, seen) == 1


@pytest.mark.parametrize(("horizon", "optimum"), [(2, 17.6), (3, 66.081)])
def test_published_values(horizon, optimum):
    solution = solve(box_pushing(), "jesp", horizon=horizon, gap=1e-9)
    assert (solution.lower, solution.upper) == pytest.approx((optimum, optimum), abs=1e-6)
