"""Whether a policy is of its model's sizes, and what is said where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from policy_files import model_of

from mdm.formats.fit import misfit
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy, FiniteStateController, JointController, QTable

MDP_OF_2 = MDP([np.eye(2)] * 3, np.zeros((2, 3)), discount=0.9)


def team(*observations):
    """Return a model of two agents of 2 and 3 actions, who share the observations given."""
    observed = Space([Factor(f"seen{place}", size) for place, size in enumerate(observations)])
    told = np.full((6, 2, len(observed)), 1 / len(observed))
    actions = Space([Factor("first", 2), Factor("second", 3)])
    return POMDP([np.eye(2)] * 6, told, np.zeros((2, 6)), discount=0.9, actions=actions, observation_names=observed)


def controller(actions, observations, **options):
    return FiniteStateController([0], [[0] * observations], actions, **options)


@pytest.mark.parametrize(
    ("policy", "model"),
    [
        (DeterministicPolicy([0, 2], 3), MDP_OF_2),
        (QTable([[0.0, 1, 2]] * 2), model_of()),
        (AlphaVectors([[1, 2]], [0], 3), model_of()),
        (controller(3, 2), model_of()),
        (controller(3, 2, values=[[1, 2]]), model_of()),
        (JointController([controller(2, 2), controller(3, 4)]), team(2, 4)),
    ],
)
def test_what_fits(policy, model):
    assert misfit(policy, model) is None


@pytest.mark.parametrize(
    ("policy", "model", "words"),
    [
        (DeterministicPolicy([0, 2, 1], 3), MDP_OF_2, "3 states and 3 actions, but the model has 2 and 3"),
        (DeterministicPolicy([0, 1], 2), MDP_OF_2, "2 states and 2 actions, but the model has 2 and 3"),
        (AlphaVectors([[1, 2, 3]], [0], 3), model_of(), "3 states and 3 actions, but the model has 2 and 3"),
        (controller(3, 2), MDP_OF_2, "goes by observations, but the model has none"),
        (controller(2, 2), model_of(), "2 actions and 2 observations, but the model has 3 and 2"),
        (controller(3, 4), model_of(), "3 actions and 4 observations, but the model has 3 and 2"),
        (controller(3, 2, values=[[1, 2, 3]]), model_of(), "values are for 3 states, but the model has 2"),
        (JointController([controller(6, 8)]), team(2, 4), "for 1 agents, but the model has 2"),
        (JointController([controller(2, 8), controller(3, 8)]), team(8), "not one for each of its 2 agents"),
        (
            JointController([controller(2, 2), controller(3, 2)]),
            team(2, 4),
            "agent 1: the policy is for 3 actions and 2 observations, but the model has 3 and 4",
        ),
    ],
)
def test_what_does_not_fit_is_said(policy, model, words):
    found = misfit(policy, model)
    assert found is not None
    assert words in found
