"""The first entry by which two models differ."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from mdm.models import MDP
from mdm.models.digest import first_difference
from mdm.problems import tiger

STATES, ACTIONS = ["hall", "lab", "dock"], ["go", "stay"]


def model(*, go=((0.5, 0.5, 0), (0, 0.5, 0.5), (1, 0, 0)), reward=1.0, discount=0.9, states=STATES, sparse=False):
    matrices = [np.array(go), np.eye(3)]
    rewards = np.zeros((3, 2))
    rewards[2, 1] = reward
    given = [csr_array(each) for each in matrices] if sparse else matrices
    return MDP(given, rewards, discount=discount, states=states, actions=ACTIONS)


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({}, None),
        ({"states": ["hall", "shop", "dock"]}, "the names of a state were lab, and are shop"),
        ({"discount": 0.8}, "the discount was 0.9, and is 0.8"),
        (
            {"go": ((0.5, 0.5, 0), (0, 0.25, 0.75), (1, 0, 0))},
            "the probability of 'lab' after 'go' in 'lab' was 0.5, and is 0.25",
        ),
        (
            {"go": ((0.5, 0.5, 0), (0.5, 0, 0.5), (1, 0, 0))},
            "the probability of 'hall' after 'go' in 'lab' was 0, and is 0.5",
        ),
        ({"reward": 3}, "the reward of 'stay' in 'dock' was 1, and is 3"),
    ],
)
def test_the_first_entry_is_told(change, told, sparse):
    assert first_difference(model(), model(**change, sparse=sparse)) == told


def test_observations_are_compared():
    told = first_difference(tiger(), tiger(accuracy=0.8))
    assert told == "the probability of observing 'hear-left' in 'tiger-left' after 'listen' was 0.85, and is 0.8"
