import numpy as np
import pytest

from mdm.models import MDP, POMDP
from mdm.policies import FiniteStateController
from mdm.verification import Decision, Way, verify

STATES, ACTIONS = ["hall", "landing", "stairs", "dock"], ["Go", "Creep", "Wait"]
GO = [[0, 0.7, 0.2, 0.1], [0, 0, 0.5, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]
CREEP = [[0, 0.9, 0, 0.1], [0, 0, 0.1, 0.9], [0, 0, 1, 0], [0, 0, 0, 1]]


def model(kind=MDP, *more):
    return kind(
        [GO, CREEP, np.eye(4)],
        *more,
        np.zeros((4, 3)),
        discount=0.9,
        states=STATES,
        actions=ACTIONS,
        initial_belief=[1, 0, 0, 0],
    )


def test_the_most_probable_way_and_the_decision_that_contributes_most():
    answer = verify(model(), "P(reach stairs)", [0, 0, 0, 0])
    assert answer.result.value == pytest.approx(0.55)
    assert answer.way == Way(("hall", "landing", "stairs"), ("Go", "Go"), pytest.approx(0.35))
    # To wait in the hall for ever is safest; to creep there leaves .45, to creep on the landing .27.
    assert answer.decision == Decision("hall", "Go", "Wait", 0)


def test_a_decision_that_is_made_once():
    moving = [GO, CREEP, CREEP]
    its = MDP(moving, np.zeros((4, 3)), discount=0.9, states=STATES, actions=ACTIONS, initial_belief=[1, 0, 0, 0])
    answer = verify(its, "P(reach stairs before dock)", [0, 0, 0, 0])
    assert answer.decision == Decision("landing", "Go", "Wait", pytest.approx(0.27))


def test_a_decision_of_a_controller_is_that_of_a_node():
    blind = np.ones((3, 4, 1))
    policy = FiniteStateController([0, 0], [[1], [1]], 3)
    answer = verify(model(POMDP, blind), "P(reach stairs)", policy)
    assert answer.result.value == pytest.approx(0.55)
    assert answer.decision == Decision("node 1", "Go", "Wait", pytest.approx(0.2))
    assert answer.way == Way(("hall", "landing", "stairs"), ("Go", "Go"), pytest.approx(0.35))


def test_there_is_none_where_nothing_can_be_lowered():
    assert verify(model(), "P(reach stairs)", [2, 0, 0, 0]).decision is None
    assert verify(model(), "P(reach stairs)", [2, 0, 0, 0]).way is None
    assert verify(model(), "P(reach hall)", [0, 0, 0, 0]).decision is None


def test_a_way_of_at_most_so_many_steps():
    assert verify(model(), "P(reach stairs within 1)", [0, 0, 0, 0]).way is None
    assert verify(model(), "P(reach stairs within 2)", [0, 0, 0, 0]).way is not None


def test_a_way_of_the_greatest_probability():
    answer = verify(model(), "P(reach stairs)")
    assert answer.greatest.value == pytest.approx(0.55)
    assert answer.way == Way(("hall", "landing", "stairs"), ("Go", "Go"), pytest.approx(0.35))
