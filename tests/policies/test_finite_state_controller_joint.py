"""Joint policies of agents that see only their own observations."""

from __future__ import annotations

import pytest

from mdm import ModelError
from mdm.policies import FiniteStateController, JointController

TEAM = JointController(
    [FiniteStateController([0, 1], [[0, 1], [None, None]]), FiniteStateController([2], [[0]], start=0)]
)


def test_each_agent_goes_its_own_way():
    assert (TEAM.num_agents, TEAM.num_actions, TEAM.num_states) == (2, 6, None)
    assert TEAM.start == (0, 0)
    assert TEAM.actions_at(TEAM.start) == (0, 2)
    assert TEAM.next_nodes((0, 0), (1, 0)) == (1, 0)
    assert TEAM.next_nodes((1, 0), (1, 0)) == (None, 0)


def test_a_teams_plan_is_over_with_the_first_agents():
    endless, plan = FiniteStateController([0], [[0]]), FiniteStateController([0, 0], [[1], [None]])
    assert JointController([endless, endless]).horizon is None
    assert JointController([endless, plan]).horizon == 2
    assert JointController([FiniteStateController([0], [[None]]), plan]).horizon == 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: JointController([]), "at least one agent"),
        (lambda: TEAM.actions_at([0]), "1 nodes are given for 2 agents"),
        (lambda: TEAM.next_nodes([0, 0], [0]), "1 observations are given for 2 agents"),
        (lambda: TEAM.actions_at([0, 1]), "no node 1"),
    ],
)
def test_what_is_wrong_is_said(make, words):
    with pytest.raises(ModelError) as caught:
        make()
    assert words in str(caught.value)
