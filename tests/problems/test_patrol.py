from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import BeliefTracker
from mdm.errors import ModelError
from mdm.problems import patrol


def test_moves_take_one_event_or_three():
    model = patrol()

    def chance(action, before, after):
        return model.transition(action, before, after)

    assert chance("Move Left", ["Corridor-West", 0, "LRM"], ["Corridor-South", 0, "LRM"]) == 0.5
    assert chance("Move Left", ["Corridor-West", 0, "LRM"], ["Corridor-West", 1, "LRM"]) == 0.5
    assert chance("Move Left", ["Corridor-West", 1, "LRM"], ["Corridor-West", 2, "LRM"]) == 1
    assert chance("Move Left", ["Corridor-West", 2, "LRM"], ["Corridor-South", 0, "LRM"]) == 1
    assert chance("Move Right", ["Corridor-West", 0, "LRM"], ["Corridor-West", 0, "LRM"]) == 1  # no door
    assert chance("Catch Goose", ["LRM", 2, "LRM"], ["LRM", 0, "No Goose"]) == pytest.approx(1 / 7)


def test_what_is_detected():
    model = patrol()
    assert model.event_observations
    seen = {
        name: model.observation("Move Up", ["LRM", phase, goose], name, state=["LRM", 0, goose])
        for phase, goose, name in [
            (0, "LRM", "Found Goose"),
            (0, "No Goose", "LRM Clear"),
            (1, "LRM", "False Negative"),
            (1, "LRM", "Soccer Field Clear"),
        ]
    }
    assert seen == {
        "Found Goose": 1,
        "LRM Clear": 1,
        "False Negative": pytest.approx(0.9),
        "Soccer Field Clear": pytest.approx(0.02),
    }


def test_rewards():
    model = patrol()
    assert model.reward("Catch Goose", ["LRM", 0, "LRM"]) == 10
    assert model.reward("Catch Goose", ["LRM", 0, "Soccer Field"]) == -5
    assert model.reward("Spawn Goose", ["LRM", 0, "No Goose"]) == 10
    assert model.reward("Move Up", ["LRM", 0, "No Goose"]) == -0.5


def test_false_negatives_make_a_difference():
    """What a robot sees next, it may see after events that it has missed."""
    model = patrol(2)
    tracker = BeliefTracker(model.with_false_negatives("False Negative"))
    state = model.state_space.index(["Room 1", 0, "No Goose"])
    tracker.reset(np.eye(len(model.state_space))[state])
    action = model.action_space.index("Move Right")
    observation = model.observation_space.index("Room 2 Clear")
    # It arrives at once, or misses both phases on its way, or takes the other room for clear in one of them.
    expected = 0.5 + 0.5 * 0.9 * 0.9 + 0.5 * (1 + 0.9) * 0.05
    assert tracker.update(action, observation) == pytest.approx(expected)


def test_several_robots():
    model = patrol(3, 2)
    assert model.state_space.shape == (3, 3, 3, 3, 4)
    assert model.action_space.shape == (6, 6)
    assert [factor.name for factor in model.observation_space.factors] == ["Observation 1", "Observation 2"]
    before, after = [0, 0, 2, 0, 2], [1, 0, 2, 0, 0]
    assert model.transition(["Move Right", "Catch Goose"], before, after) == pytest.approx(0.5 / 4)
    assert model.reward(["Move Right", "Catch Goose"], before) == pytest.approx(-0.5 - 5)


def test_refused():
    with refused(ModelError):
        patrol(1)
