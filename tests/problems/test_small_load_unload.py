from __future__ import annotations

import pytest
from sentences import refused

from mdm import ModelError, solve
from mdm.problems import load_unload


def test_sizes_of_the_paper():
    model = load_unload()
    assert (len(model.state_space), len(model.action_space), len(model.observation_space)) == (14, 2, 3)


def test_a_round_trip():
    model = load_unload(3)
    assert model.state_space.names == ("empty-0", "empty-1", "loaded-1", "loaded-2")
    states = ["empty-0", "empty-1", "loaded-2", "loaded-1", "empty-0"]
    for state, then, action in zip(states, states[1:], ["right", "right", "left", "left"], strict=False):
        assert model.transition(action, state, then) == 1
    assert model.rewards.tolist() == [[0, 0], [0, 0], [1, 0], [0, 0]]
    assert model.observation("left", "empty-1").tolist() == model.observation("left", "loaded-1").tolist() == [0, 1, 0]
    assert model.transition("left", "empty-0", "empty-0") == model.transition("right", "loaded-2", "loaded-2") == 1


@pytest.mark.parametrize(("positions", "discount"), [(2, 0.9), (4, 0.95), (8, 0.95)])
def test_the_value_is_that_of_going_to_and_fro(positions, discount):
    steps = 2 * positions - 2
    solution = solve(load_unload(positions, discount=discount), gap=1e-6)
    assert solution.lower == pytest.approx(discount ** (steps - 1) / (1 - discount**steps), abs=1e-5)


def test_a_track_has_two_ends():
    with refused(ModelError):
        load_unload(1)
