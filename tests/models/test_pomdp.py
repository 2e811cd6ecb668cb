"""POMDPs: observations of states and of events, by names and indices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from random_models import dense, flat_models
from sentences import refused

from mdm.errors import ModelError
from mdm.models import POMDP

IDENTITY = [np.eye(2)] * 2
REWARDS = np.zeros((2, 2))


def test_pomdp_checks_its_observations():
    with refused(ModelError):
        POMDP(IDENTITY, [np.eye(2), [[1, 0], [0, 0.5]]], REWARDS, discount=0.9)
    model = POMDP(IDENTITY, [np.eye(2)] * 2, REWARDS, discount=0.9, observation_names=["dark", "bright"])
    assert model.kind == "POMDP"
    assert list(model.observation_space.names) == ["dark", "bright"]


@given(flat_models(kinds=("POMDP",), events=True))
def test_what_is_observed_is_the_same_by_matrix_row_and_joint_probability(model):
    actions, states, observations = model.action_space, model.state_space, model.observation_space
    for a in range(len(actions)):
        moves = dense(model.transition_matrix(a))
        for o in range(len(observations)):
            joint = dense(model.joint_matrix(a, o))
            for s, t in np.ndindex(moves.shape):
                if moves[s, t] > 0:
                    told = model.observation(a, t, o, state=s)
                    assert joint[s, t] == pytest.approx(moves[s, t] * told, abs=1e-15)
                    assert told == model.observation(actions.names[a], states.names[t], state=states.names[s])[o]
                else:
                    assert joint[s, t] == 0
            if not model.event_observations:
                np.testing.assert_array_equal(
                    dense(model.observation_matrix(a))[:, o], [model.observation(a, t, o) for t in range(len(states))]
                )


def test_each_kind_of_observations_says_how_it_is_asked():
    events = POMDP(IDENTITY, np.full((2, 2, 2, 2), 0.5), REWARDS, discount=0.9, event_observations=True)
    plain = POMDP(IDENTITY, [np.eye(2)] * 2, REWARDS, discount=0.9)
    with refused(ModelError):
        events.observation_matrix(0)
    with refused(ModelError):
        events.observation(0, 0)
    with refused(ModelError):
        plain.event_matrix(0, 0)
    assert (plain.events, plain.event_observations, events.event_observations) == (None, False, True)


@pytest.mark.parametrize(
    ("observations", "options", "message"),
    [
        ([np.eye(2)], {}, "O is given for 1 actions, but the model has 2"),
        ([np.eye(3)] * 2, {}, "O of action"),
        ([np.eye(2)] * 2, {"observation_names": ["only"]}, "O is over 2 observations, but 1 names"),
        ([[1, 0]] * 2, {}, "an actions x states x observations array, or a matrix per action"),
        ([], {}, "an actions x states x observations array, or a matrix per action"),
    ],
)
def test_other_shapes_are_refused(observations, options, message):
    with pytest.raises(ModelError, match=message):
        POMDP(IDENTITY, observations, REWARDS, discount=0.9, **options)


def test_a_flat_model_is_its_own_matrices_and_is_told_in_words():
    model = POMDP(IDENTITY, [np.eye(2)] * 2, REWARDS, discount=0.9, initial_belief=[0.25, 0.75])
    assert model.flatten() is model
    assert model.revealed() is model
    np.testing.assert_array_equal(model.belief_at_start(0), [0.25, 0.75])
    assert repr(model).endswith("2 observations>")
    assert repr(model.with_false_negatives(1)).endswith("2 observations, false negative '1'>")
