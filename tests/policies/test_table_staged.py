from __future__ import annotations

import numpy as np
import pytest

from mdm.errors import ModelError
from mdm.policies import StagedPolicy

TABLE = [[[1.0, 2.0], [3.0, 3.0]], [[5.0, 4.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, -1.0]]]


def test_each_stage_chooses_for_itself():
    policy = StagedPolicy(TABLE)
    assert (policy.horizon, policy.num_states, policy.num_actions, policy.input) == (3, 2, 2, "state")
    assert [[policy.action(state, stage) for state in range(2)] for stage in range(3)] == [[1, 0], [0, 1], [0, 0]]
    assert [policy.value(0, stage) for stage in range(3)] == [2, 5, 0]


def test_without_a_stage_it_is_the_first():
    policy = StagedPolicy(TABLE)
    assert (policy.action(0), policy.value(0)) == (1, 2)
    np.testing.assert_array_equal(policy.at(1).values, TABLE[1])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: p.action(2), "there is no state 2; the policy is for 2 states"),
        (lambda p: p.action(-1), "there is no state -1"),
        (lambda p: p.action(0, 3), "there is no stage 3; the policy is for 3"),
        (lambda p: p.value(0, -1), "there is no stage -1"),
        (lambda p: p.at(3), "there is no stage 3"),
    ],
)
def test_places_that_are_not_there(call, message):
    with pytest.raises(ModelError, match=message):
        call(StagedPolicy(TABLE))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([[1.0]], "stages x states x actions array, not one of shape"),
        (np.zeros((2, 0, 1)), "stages x states x actions"),
        ([[[0.0, np.nan]]], "at stage 0 the value of action 1 in state 0 is NaN"),
    ],
)
def test_what_is_no_table(values, message):
    with pytest.raises(ModelError, match=message):
        StagedPolicy(values)
