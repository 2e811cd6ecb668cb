"""Whether two models are the same, number by number."""

from __future__ import annotations

import numpy as np

from mdm.models import POMDP


def dense(matrix):
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def assert_same_model(model, other, *, atol=1e-9):
    """Compare sizes, discount, initial belief, T, O and expected rewards; names may differ."""
    assert model.kind == other.kind
    assert len(model.state_space) == len(other.state_space)
    assert model.action_space.shape == other.action_space.shape
    assert model.discount == other.discount
    np.testing.assert_allclose(model.initial_belief, other.initial_belief, atol=atol, err_msg="initial belief")
    np.testing.assert_allclose(model.rewards, other.rewards, atol=atol, err_msg="R")
    for action, name in enumerate(other.action_space.names):
        transitions = dense(model.transition_matrix(action)), dense(other.transition_matrix(action))
        np.testing.assert_allclose(*transitions, atol=atol, err_msg=f"T of {name}")
        if not isinstance(model, POMDP):
            continue
        assert model.observation_space.shape == other.observation_space.shape
        assert model.event_observations == other.event_observations
        if model.event_observations:
            for seen in range(len(model.observation_space)):
                events = (dense(each.joint_matrix(action, seen)) for each in (model, other))
                np.testing.assert_allclose(*events, atol=atol, err_msg=f"P(s', o | s, a) of {name}, {seen}")
        else:
            observations = dense(model.observation_matrix(action)), dense(other.observation_matrix(action))
            np.testing.assert_allclose(*observations, atol=atol, err_msg=f"O of {name}")
