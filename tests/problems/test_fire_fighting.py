from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import solve
from mdm.errors import ModelError
from mdm.models import POMDP
from mdm.problems import fire_fighting, fire_fighting_graph


@pytest.mark.parametrize(
    ("actions", "before", "after", "probability"),
    [
        ("go1 go1", "f2 f0 f0", "f0 f0 f0", 0.2),  # it had burned when it lit its neighbour
        ("go1 go2", "f2 f0 f0", "f1 f0 f0", 1),
        ("go1 go2", "f2 f1 f0", "f1 f0 f1", 0.6 * 0.6 * 0.8),
        ("go1 go3", "f0 f1 f0", "f0 f2 f0", 0.4),
        ("go1 go1", "f0 f0 f0", "f0 f0 f0", 1),
        ("go2 go3", "f1 f1 f1", "f2 f0 f0", 0.8 * 0.6 * 0.6),
    ],
)
def test_fires(actions, before, after, probability):
    model = fire_fighting()
    places = " ".join(f"h{go[-1]}" for go in actions.split())
    assert model.transition(actions, f"{before} start start", f"{after} {places}") == pytest.approx(probability)


def test_observations():
    model = fire_fighting()
    assert model.observation("go1 go3", "f0 f1 f2 h1 h3", "flames noFlames") == pytest.approx(0.2 * 0.2)
    assert model.observation("go2 go3", "f0 f1 f2 h2 h3", "noFlames flames") == pytest.approx(0.5 * 0.8)


def test_start_and_rewards():
    model = fire_fighting()
    assert len(model.state_space) == 27 * 16
    assert model.initial_belief[model.state_space.index("f2 f1 f0 start start")] == pytest.approx(1 / 27)
    assert model.reward("go1 go1", "f2 f2 f2 start start") == pytest.approx(-4)
    assert model.reward("go1 go2", "f2 f0 f0 start start") == pytest.approx(-1)


def test_published_values():
    """The published -4.383496 and -5.736969 are of probabilities that are rounded to two digits."""
    model = rounded(fire_fighting().flatten())
    for horizon, optimum in [(2, -4.383496), (3, -5.736969)]:
        solution = solve(model, "jesp", horizon=horizon, gap=1e-9)
        assert (solution.lower, solution.upper) == pytest.approx((optimum, optimum), abs=1e-6)


def rounded(model):
    """Return a model whose probabilities are rounded to two digits, each row's sum kept at 1 by its first entry."""
    transitions = [np.round(model.transition_matrix(action), 2) for action in range(9)]
    later = -sum(np.indices((3, 3, 3, 4, 4))[:3]).reshape(-1)
    for transition in transitions:
        for row in np.flatnonzero(transition.sum(axis=1) != 1):
            transition[row, transition[row].argmax()] += 1 - transition[row].sum()
    return POMDP(
        transitions,
        [model.observation_matrix(action) for action in range(9)],
        np.stack([transition @ later for transition in transitions], axis=1),
        discount=1.0,
        actions=model.action_space,
        observation_names=model.observation_space,
        initial_belief=model.initial_belief,
    )


@pytest.mark.parametrize(
    ("actions", "before", "after", "probability"),
    [
        ("right left right", "f2 f2 f0 f1", "f2 f0 f1 f0", 0.8),  # two at house 2, one at house 4
        ("left left left", "f0 f0 f0 f1", "f0 f0 f0 f2", 0.4 * 1),
        ("left right left", "f1 f0 f0 f0", "f0 f1 f0 f0", 0.8),
    ],
)
def test_fires_between_neighbours(actions, before, after, probability):
    model = fire_fighting_graph()
    assert model.transition(actions, before, after) == pytest.approx(probability)


def test_sides():
    model = fire_fighting_graph()
    assert (len(model.state_space), model.num_agents) == (81, 3)
    seen = model.observation("left right left", "f2 f0 f1 f0", "flames noFlames flames")
    assert seen == pytest.approx(0.8 * 0.5 * 0.5)
    assert fire_fighting_graph(1, 4).state_space.shape == (4, 4)


def test_one_agent_between_two_houses():
    model = fire_fighting_graph(1, 2)
    assert model.rewards[model.state_space.index("f1 f0"), 0] == pytest.approx(-0.8)
    assert model.rewards[model.state_space.index("f1 f1"), 0] == pytest.approx(-0.4 - 1)


def test_refused():
    with refused(ModelError):
        fire_fighting(3, 0)
    with refused(ModelError):
        fire_fighting_graph(3, 1)
