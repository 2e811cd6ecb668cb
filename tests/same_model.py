"""Whether two models are the same, number by number."""

from __future__ import annotations

import numpy as np

from mdm.models import POMDP


def assert_same_model(model, other, *, atol=1e-9):
    """Compare sizes, discount, initial belief, T, O and expected rewards; names and factors may differ."""
    assert model.kind == other.kind
    assert model.num_agents == other.num_agents
    assert len(model.state_space) == len(other.state_space)
    assert model.action_space.shape == other.action_space.shape
    assert model.discount == other.discount
    np.testing.assert_allclose(model.initial_belief, other.initial_belief, rtol=0, atol=atol, err_msg="initial belief")
    np.testing.assert_allclose(model.rewards, other.rewards, rtol=0, atol=atol, err_msg="R")
    for action, name in enumerate(other.action_space.names):
        assert_same_matrix(model.transition_matrix(action), other.transition_matrix(action), f"T of {name}", atol)
        if not isinstance(model, POMDP):
            continue
        assert len(model.observation_space) == len(other.observation_space)
        assert model.event_observations == other.event_observations
        if model.event_observations:
            for seen in range(len(model.observation_space)):
                joint = (each.joint_matrix(action, seen) for each in (model, other))
                assert_same_matrix(*joint, f"P(s', o | s, a) of {name}, {seen}", atol)
        else:
            assert_same_matrix(model.observation_matrix(action), other.observation_matrix(action), f"O of {name}", atol)


def assert_same_matrix(left, right, what, atol):
    if isinstance(left, np.ndarray) or isinstance(right, np.ndarray):
        left, right = (each if isinstance(each, np.ndarray) else each.toarray() for each in (left, right))
    off = abs(left - right)
    assert left.shape == right.shape
    assert off.max() <= atol, f"{what} differs by {off.max()} at {divmod(int(off.argmax()), left.shape[1])}"
