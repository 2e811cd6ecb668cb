from __future__ import annotations

import numpy as np
import pytest

from mdm import ModelError
from mdm.problems import hallway, hallway2


def test_sizes():
    assert [len(space) for space in (hallway().state_space, hallway().observation_space)] == [60, 21]
    assert [len(space) for space in (hallway2().state_space, hallway2().observation_space)] == [92, 17]


def test_moves():
    model = hallway()
    moved = model.transition("forward", "row0-column1 east")
    expected = {
        "row0-column2 east": 0.8,
        "row0-column1 east": 0.15,
        "row0-column0 east": 0.025,
        "row0-column0 west": 0.025,
    }
    assert {model.state_space.names[s]: round(moved[s], 12) for s in np.flatnonzero(moved)} == expected
    assert model.transition("turn-right", "row0-column0 west", "row0-column0 north") == 0.7
    assert model.transition("turn-left", "row0-column0 north", "row0-column0 west") == 0.7
    assert model.transition("turn-around", "row0-column0 north").max() == 0.6
    assert model.reward("forward", "row0-column8 south") == pytest.approx(0.8)


def test_sight():
    model = hallway()
    assert model.observation("stay", "row0-column0 north", "front-back-left") == pytest.approx(0.9**3 * 0.95)
    assert model.observation("stay", "row0-column2 south", "landmark-a") == 1
    assert model.observation("stay", "row1-column8 north", "goal") == 1


def test_the_goal_leads_to_a_start():
    model = hallway(".+.")
    for action in model.action_space.names:
        assert model.transition(action, "row0-column1 east").tolist() == pytest.approx(
            [1 / 8] * 4 + [0] * 4 + [1 / 8] * 4
        )


@pytest.mark.parametrize(
    ("maze", "words"), [("", "no cell"), ("...", "needs a goal"), ("+", "needs a goal"), (".X+", "'X'")]
)
def test_wrong_mazes(maze, words):
    with pytest.raises(ModelError, match=words):
        hallway(maze)
