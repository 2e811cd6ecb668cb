"""Decisions of many episodes at once, against those of the policies one by one."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from mdm.policies import AlphaVectors
from mdm.policies.batch import BeliefBatch, ProbabilityBatch, TableBatch
from mdm.problems import tiger

NONE = np.zeros(0)


def test_a_table_goes_through_its_stages_and_stays_at_the_last():
    batch = TableBatch(np.array([[0, 1], [2, 3]]))
    states = np.array([1, 0, 1])
    assert batch.begin(states, NONE).tolist() == [1, 0, 1]
    for _ in range(3):
        assert batch.next(NONE, states, NONE, NONE, NONE).tolist() == [3, 2, 3]
    assert batch.begin(states, NONE).tolist() == [1, 0, 1]


@given(st.integers(0, 2**32 - 1))
def test_numbers_draw_actions_by_their_shares(seed):
    random = np.random.default_rng(seed)
    weights = random.dirichlet(np.ones(3), size=2).T
    weights[random.integers(3), 0] = 0
    batch = ProbabilityBatch(weights / weights.sum(axis=0))
    states, numbers = random.integers(2, size=50), random.random(50)
    ends = np.cumsum(weights / weights.sum(axis=0), axis=0)
    for action, state, number in zip(batch.begin(states, numbers), states, numbers, strict=True):
        assert number < ends[action, state] or action == 2
        assert action == 0 or number >= ends[action - 1, state]


def test_beliefs_are_tracked_for_each_episode():
    model = tiger(discount=0.95)
    policy = AlphaVectors([[0, 0], [-10, 3], [3, -10]], [0, 1, 2])
    batch = BeliefBatch(policy, model)
    assert batch.begin(np.array([0, 1, 0]), NONE).tolist() == [0, 0, 0]
    everyone, listen = np.arange(3), np.zeros(3, dtype=int)
    states = np.array([0, 1, 0])
    assert batch.next(everyone, states, listen, np.array([0, 1, 0]), NONE).tolist() == [
        policy.action([0.85, 0.15]),
        policy.action([0.15, 0.85]),
        policy.action([0.85, 0.15]),
    ]
    batch.keep(np.array([False, True, True]))
    two = np.arange(2)
    found = batch.next(two, states[1:], listen[1:], np.array([1, 1]), NONE).tolist()
    sure = 0.85**2 / (0.85**2 + 0.15**2)
    assert found == [policy.action([1 - sure, sure]), policy.action([0.5, 0.5])]
