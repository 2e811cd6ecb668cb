import numpy as np

from mdm import problems
from mdm.models import MDP
from mdm.policies import DeterministicPolicy
from mdm.verification.dangers import avoidable_end


def corridor(pit=-1.0, goal=1.0):
    """Four cells in a row between a pit and a goal: to the left, to the right, or to the right and sometimes back."""
    size = 6
    ways = np.zeros((3, size, size))
    ways[:, 0, 0] = ways[:, 5, 5] = 1
    rewards = np.zeros((3, size, size))
    rewards[:, 1:5] = -0.4
    rewards[:, 1:5, 0] = pit
    rewards[:, 1:5, 5] = goal
    for cell in range(1, 5):
        ways[0, cell, cell - 1] = ways[1, cell, cell + 1] = 1
        ways[2, cell, cell - 1], ways[2, cell, cell + 1] = 0.2, 0.8
    names = ["pit", "c1", "c2", "c3", "c4", "goal"]
    return MDP(ways, rewards, discount=0.95, states=names, initial_belief=np.eye(size)[1])


def policy(action):
    return DeterministicPolicy([action] * 6, 3)


def test_a_policy_that_ends_in_a_pit_is_told():
    assert avoidable_end(corridor(), policy(0)) == (
        "the policy ends in 'pit' with probability 1, and 0 is possible on a way to 'goal': see mdm verify MODEL "
        "POLICY 'P(reach \"pit\")'"
    )
    assert "with probability 0.249" in avoidable_end(corridor(), policy(2))


def test_others_are_not():
    assert avoidable_end(corridor(), policy(1)) is None
    assert avoidable_end(corridor(pit=2.0), policy(0)) is None  # it is the better end
    assert avoidable_end(corridor(pit=1.0), policy(0)) is None  # one is as good as the other
    assert avoidable_end(problems.forest(), policy(1)) is None  # nothing is absorbing
    assert avoidable_end(corridor(), object()) is None


def test_what_cannot_be_avoided_is_not_told():
    model = corridor()
    risky = MDP([model.transition_matrix(2)] * 3, model.rewards, discount=0.95, initial_belief=np.eye(6)[1])
    assert avoidable_end(risky, policy(2)) is None
