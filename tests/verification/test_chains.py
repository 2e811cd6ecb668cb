import numpy as np
import pytest

from mdm import problems
from mdm.errors import ModelError
from mdm.models import MDP
from mdm.policies import DeterministicPolicy, FiniteStateController, JointController, StagedPolicy, StochasticPolicy
from mdm.verification import chains, verify
from mdm.verification.chains import chain_of_policy

TOSS = MDP([[[0.5, 0.5], [0, 1]], np.eye(2)], np.zeros((2, 2)), discount=0.9, states=["a", "b"], actions=["Go", "Stay"])


def test_actions_are_drawn():
    chain = chain_of_policy(TOSS, StochasticPolicy([[0.5, 0], [0.5, 1]]))
    assert chain.moves.toarray().tolist() == [[0.75, 0.25], [0, 1]]
    assert chain.chances(np.array([[True, False, False], [False, False, False]])).tolist() == [0.5, 0]
    answer = verify(TOSS, "E(steps until b)", StochasticPolicy([[0.5, 0], [0.5, 1]]), start="a")
    assert answer.result.value == pytest.approx(4)


def test_a_plan_by_stages_ends_and_its_state_stays():
    policy = StagedPolicy([[[1, 0], [1, 0]], [[1, 0], [1, 0]]])  # to go, twice
    assert verify(TOSS, "P(reach b)", policy, start="a").result.value == 0.75
    assert verify(TOSS, "S(a)", policy, start="a").result.value == 0.25
    assert verify(TOSS, "E(steps until b)", policy, start="a").result.value == np.inf
    assert verify(TOSS, "P(reach action = Stay)", policy).result.value == 0


def test_a_controller_goes_by_what_it_sees():
    tiger = problems.tiger()
    listen_once = FiniteStateController([0, 1, 2], [[2, 1], [None, None], [None, None]], 3)
    answer = verify(tiger, "P(reach tiger-left and action = open-left)", listen_once)
    assert answer.result.value == pytest.approx(0.5 * 0.15)
    assert verify(tiger, "S(action = listen)", listen_once).result.value == 0


def test_controllers_of_a_team_are_one():
    listen = FiniteStateController([0], [[0, 0]], 3)
    model = problems.dec_tiger()
    answer = verify(model, 'S(action = "listen listen")', JointController([listen, listen]))
    assert answer.result.value == 1


def test_where_nothing_is_detected_the_action_goes_on():
    quiet = problems.tiger().with_false_negatives("hear-left")
    policy = FiniteStateController([0, 1], [[1, 1], [1, 1]], 3)
    steps = verify(quiet, "E(steps until action = open-left)", policy).result.value
    # With the tiger behind the left door, 15 % of the steps hear it behind the right one; behind the right door, 85 %.
    assert steps == pytest.approx((1 / 0.15 + 1 / 0.85) / 2)


def test_policies_of_other_kinds_have_no_chain(monkeypatch):
    assert chain_of_policy(problems.tiger(), object()) is None
    monkeypatch.setattr(chains, "_SIZE", 3)
    with pytest.raises(ModelError, match="has 3 x 2 states"):
        chain_of_policy(TOSS, StagedPolicy(np.zeros((2, 2, 2))))
    assert chain_of_policy(TOSS, DeterministicPolicy([0, 1], 2)) is not None
