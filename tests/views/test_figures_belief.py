"""Pictures of beliefs: between two states, and over an episode."""

from __future__ import annotations

import numpy as np
import pytest
from places import DATA, TIGER, TIGER_VECTORS
from sentences import refused

from mdm import BeliefTracker, Error, ModelError, load_model, load_policy
from mdm.models import POMDP
from mdm.policies import AlphaVectors
from mdm.views.figures import belief_figure, state_name, two_state_figure

pytest.importorskip("matplotlib")


def test_doubt_is_drawn_where_it_is():
    model = load_model(TIGER)
    policy = load_policy(TIGER_VECTORS, model)
    axes = two_state_figure(model, policy, None, 0).axes[0]
    shares, values = axes.lines[-1].get_data()
    np.testing.assert_allclose(values, [policy.value(np.array([1 - share, share])) for share in shares])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["listen", "open-left", "open-right"]


def test_a_belief_is_that_of_its_episode():
    model = load_model(TIGER)
    policy = load_policy(TIGER_VECTORS, model)
    axes = belief_figure(model, policy, 12, 5).axes[0]
    shown = np.asarray(axes.images[0].get_array())
    assert shown.shape == (2, 12)
    tracker, before = BeliefTracker(model), None
    for column, label in zip(shown.T, axes.get_xticklabels(), strict=True):
        seen, _, done = label.get_text().partition("→")
        if before is not None:
            tracker.update(before, model.observation_space.index(seen.strip()))
        np.testing.assert_allclose(column, tracker.belief)
        before = model.action_space.index(done.strip())


def test_two_states_are_named_or_told_apart_by_nothing():
    model = load_model(TIGER)
    policy = load_policy(TIGER_VECTORS, model)
    axes = two_state_figure(model, policy, ["tiger-right", "tiger-left"], 0).axes[0]
    assert axes.get_xlabel() == "belief in 'tiger-left', the rest in 'tiger-right'"
    with refused(ModelError):
        two_state_figure(model, policy, ["tiger-left", "tiger-left"], 0)
    seen = POMDP([np.eye(2)], [np.eye(2)], [[1.0], [0]], discount=0.5, initial_belief=[1, 0])
    with refused(Error):
        two_state_figure(seen, AlphaVectors([[2.0, 0]], [0], 1), None, 0)


def test_states_are_found_where_nothing_can_be_earned():
    doubtful = POMDP([np.eye(3)], [np.eye(3)], np.zeros((3, 1)), discount=0.5, initial_belief=[0.5, 0, 0.5])
    axes = two_state_figure(doubtful, AlphaVectors([[0.0, 0, 0]], [0], 1), None, 0).axes[0]
    assert axes.get_xlabel() == "belief in '2', the rest in '0'"


def test_one_state_makes_no_picture():
    alone = POMDP([np.eye(1)], [np.eye(1)], [[1.0]], discount=0.5)
    with refused(Error):
        two_state_figure(alone, AlphaVectors([[2.0]], [0], 1), None, 0)


def test_states_of_several_factors_are_told_with_their_names():
    model = load_model(DATA / "patrol" / "rooms.pomdpx")
    policy = load_policy(DATA / "patrol" / "rooms.vf", model)
    axes = belief_figure(model, policy, 5, 1).axes[0]
    told = [label.get_text() for label in axes.get_yticklabels()]
    assert "robot=Lobby, fire=nowhere" in told
    assert state_name(model.state_space, 1) == "robot=Lobby, fire=Lobby"
    assert (
        "belief in 'robot=Lobby, fire=nowhere'" in two_state_figure(model, policy, ["1", "0"], 0).axes[0].get_xlabel()
    )


def test_shades_go_up_to_the_largest_belief():
    size = 100
    model = POMDP([np.eye(size)], [np.ones((size, 1))], np.ones((size, 1)), discount=0.5)
    image = belief_figure(model, AlphaVectors([[2.0] * size], [0], 1), 4, 0).axes[0].images[0]
    assert image.get_clim() == pytest.approx((0, 1 / size))


def test_states_between_which_the_action_changes_are_drawn():
    """Of the pairs that share most belief all choose the same action; another pair tells more."""
    start = [0.3, 0.3, 0.25, 0.15]
    model = POMDP([np.eye(4)] * 2, [np.ones((4, 1))] * 2, np.ones((4, 2)), discount=0.5, initial_belief=start)
    policy = AlphaVectors([[5.0, 5, 5, 0], [0, 0, 0, 9]], [0, 1], 2)
    assert "'3'" in two_state_figure(model, policy, None, 0).axes[0].get_xlabel()
    same = AlphaVectors([[5.0, 5, 5, 5]], [0], 2)
    assert two_state_figure(model, same, None, 0).axes[0].get_xlabel() == "belief in '1', the rest in '0'"
