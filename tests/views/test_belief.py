"""Pictures of beliefs: between two states, and over an episode."""

from __future__ import annotations

import numpy as np
import pytest
from places import TIGER, TIGER_VECTORS

from mdm import BeliefTracker, Error, ModelError, load_model, load_policy
from mdm.models import POMDP
from mdm.policies import AlphaVectors
from mdm.views.belief import belief_figure, two_state_figure

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
    with pytest.raises(ModelError, match="two states are needed, not 'tiger-left' twice"):
        two_state_figure(model, policy, ["tiger-left", "tiger-left"], 0)
    seen = POMDP([np.eye(2)], [np.eye(2)], [[1.0], [0]], discount=0.5, initial_belief=[1, 0])
    with pytest.raises(Error, match="state is always certain: name two states"):
        two_state_figure(seen, AlphaVectors([[2.0, 0]], [0], 1), None, 0)
