"""A team's dynamics: joint symbols, steps of beliefs, and models that are none of a team."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense
from teams import team

from mdm.solvers.jesp import Team


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_steps_are_those_of_the_model(seed, events):
    model = team(seed, states=3, observations=3, events=events)
    dynamics = Team(model)
    random = np.random.default_rng(seed)
    beliefs = random.random((2, 4, 3))
    actions = random.integers(4, size=4)
    after = dynamics.advance(beliefs, actions)
    assert after.shape == (2, 4, 9, 3)
    for column, action in enumerate(actions.tolist()):
        for observation in range(9):
            expected = beliefs[:, column] @ dense(model.joint_matrix(action, observation))
            np.testing.assert_allclose(after[:, column, observation], expected, atol=1e-12)


def test_joint_symbols_and_their_parts():
    model = team(1, agents=3, observations=2)
    dynamics = Team(model)
    assert dynamics.seen.tolist() == [list(model.observation_space.unravel(o)) for o in range(8)]
    own = [np.array([0, 1]), 1, np.array([1, 0])]
    assert dynamics.joint_actions(own).tolist() == [
        model.action_space.ravel((0, 1, 1)),
        model.action_space.ravel((1, 1, 0)),
    ]
    np.testing.assert_array_equal(dynamics.rewards, model.rewards.T)


def test_as_one_agent_it_has_the_joint_symbols():
    dynamics = Team(team(1), as_one=True)
    assert (dynamics.num_agents, dynamics.actions, dynamics.observations) == (1, (4,), (4,))
    assert dynamics.seen.tolist() == [[0], [1], [2], [3]]
    assert pytest.approx(dynamics.start.sum()) == 1
