from __future__ import annotations

import numpy as np
import pytest
from same_model import assert_same_model

from mdm import ModelError, load_model, solve
from mdm.models import MixedPOMDP, Node
from mdm.problems import field_vision_rock_sample, rock_sample


@pytest.mark.foreign("RockSample_11_11.pomdpx of AdaCompNUS/sarsop")
def test_the_larger_published_instance(corpus):
    # Too large for matrices: the networks are compared, factor by factor, at some states.
    mine = rock_sample(11, 11)
    theirs = load_model(corpus / "models" / "sarsop" / "RockSample_11_11.pomdpx")
    assert mine.state_space.shape == theirs.state_space.shape == (122, *[2] * 11)
    assert mine.action_space.shape == theirs.action_space.shape
    assert mine.network.fully_observed == theirs.network.fully_observed
    states = np.array([0, 1, 4095, 2048 * 5 + 17, 2048 * 66 + 1234, 2048 * 102 + 2047, 2048 * 121])
    for action, name in enumerate(mine.action_space.names):
        for role in ("state", "next_state", "observation"):
            if (name, role) == ("check-10", "observation"):
                continue  # in the file the last check is of rock 1
            for place in range(len(mine.network.factors(role))):
                rows = [distributions(model.network, Node(role, place), action, states) for model in (mine, theirs)]
                np.testing.assert_allclose(*rows, rtol=0, atol=1e-6)
        np.testing.assert_allclose(*(utilities(model.network, action, states) for model in (mine, theirs)))


def digits(network, action, states):
    """Return an action, states, and the same as next states, by variable."""
    values = {Node("action", 0): np.full(len(states), action)}
    for place, digit in enumerate(np.unravel_index(states, network.states.shape)):
        values[Node("state", place)] = values[Node("next_state", place)] = digit
    return values


def distributions(network, child, action, states):
    potential = network.potentials(child.role)[child.place]
    return potential.rows(digits(network, action, states), len(states), child, len(network.factor(child)))


def utilities(network, action, states):
    return sum(utility.rows(digits(network, action, states), len(states), None, 1) for utility in network.utilities)


def test_entries():
    model = rock_sample(3, 2, positions=[(2, 0), (0, 2)], half_distance=2)
    assert model.state_space.shape == (10, 2, 2)
    assert model.action_space.names == ("north", "east", "south", "west", "check-0", "check-1", "sample")
    assert model.initial_belief[model.state_space.index("x0-y1 good bad")] == 0.25
    assert model.transition("north", "x0-y1 good bad", "x0-y2 good bad") == 1
    assert model.transition("east", "x2-y0 good bad", "end good bad") == 1
    assert model.transition("west", "x0-y0 good bad", "end good bad") == 1
    assert model.transition("sample", "x2-y0 good good", "x2-y0 bad good") == 1
    assert model.transition("sample", "x1-y1 good good", "end good good") == 1
    assert model.reward("sample", "x2-y0 good bad") == 10
    assert model.reward("sample", "x0-y2 good bad") == -10
    assert model.reward("sample", "x1-y1 good bad") == model.reward("north", "x0-y2 good bad") == -100
    assert model.reward("east", "x2-y1 bad bad") == 10
    assert model.reward("sample", "end good bad") == model.reward("east", "end good bad") == 0
    assert model.observation("check-0", "x0-y0 good bad", "good") == pytest.approx((1 + 0.5) / 2)  # 2 away
    assert model.observation("check-1", "x0-y2 good bad", "bad") == 1
    assert model.observation("north", "x1-y1 bad bad", "good") == 1


def test_the_rover_is_seen():
    revealed = rock_sample(3, 2, positions=[(2, 0), (0, 2)]).revealed()
    assert isinstance(revealed, MixedPOMDP)
    assert revealed.layout.shape == (10, 4)


def test_checking_where_it_is_certain():
    # Check, then sample a good rock and leave, or leave at once.
    value = 0.95 * (0.5 * (10 + 0.95 * 10) + 0.5 * 10)
    solution = solve(rock_sample(1, 1, positions=[(0, 0)]), gap=1e-6)
    assert solution.lower == pytest.approx(value, abs=1e-5)


def test_seeing_on_arrival():
    # To the east is the rock: from there it is seen for sure.
    value = 0.95 * (0.5 * (10 + 0.95 * 10) + 0.5 * 10)
    model = field_vision_rock_sample(2, 1, positions=[(1, 0)], start=(0, 0), half_distance=0.01)
    assert solve(model, gap=1e-6).lower == pytest.approx(value, abs=1e-3)


def test_field_vision():
    model = field_vision_rock_sample(3, 2, positions=[(2, 0), (0, 2)], half_distance=2)
    assert (len(model.action_space), len(model.observation_space)) == (5, 4)
    near, far = (1 + 2 ** (-2 / 2)) / 2, (1 + 2 ** (-2 / 2)) / 2
    assert model.observation("north", "x0-y0 good bad", "good bad") == pytest.approx(near * far)
    assert model.observation("sample", "x2-y0 good bad", "bad good") == 0
    assert len(field_vision_rock_sample(5, 7).observation_space) == 128


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"size": 2, "rocks": 5}, "no room for 5"),
        ({"rocks": 0}, "at least one"),
        ({"rocks": 2, "positions": [(0, 0)]}, "2 rocks need as many positions"),
        ({"rocks": 2, "positions": [(0, 0), (0, 0)]}, "each another one"),
        ({"rocks": 1, "positions": [(7, 0)]}, r"a rock is at \(7, 0\), outside"),
        ({"start": (0, -1)}, "the start is at"),
        ({"half_distance": 0}, "half distance"),
    ],
)
def test_wrong_settings(settings, words):
    with pytest.raises(ModelError, match=words):
        rock_sample(**settings)


def test_positions_of_an_instance_that_was_not_published_are_always_the_same():
    assert_same_model(rock_sample(4, 3), rock_sample(4, 3))
