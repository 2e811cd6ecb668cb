"""Problems that are collected instead of raised."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from random_models import dense
from sentences import refused

from mdm import ModelError
from mdm.beliefs import BeliefTracker
from mdm.models import (
    POMDP,
    Factor,
    FactoredMDP,
    FactoredPOMDP,
    Node,
    Space,
    Table,
    TwoSliceNetwork,
)
from mdm.models.validation import Problem, collect_problems, is_collecting, report


def test_no_report_is_taken_unless_problems_are_collected():
    assert not is_collecting()
    assert not report("wrong", is_sum=True)
    with collect_problems() as problems:
        assert is_collecting()
        assert report("wrong")
        assert report("too little", is_sum=True)
    assert problems == [Problem("wrong", is_sum=False), Problem("too little", is_sum=True)]
    assert not report("wrong", is_sum=True)
    assert len(problems) == 2


def test_sums_alone_may_be_collected():
    with collect_problems(sums_only=True) as problems:
        assert not report("wrong")
        assert report("too little", is_sum=True)
    assert [problem.text for problem in problems] == ["too little"]


def test_the_innermost_collection_takes_what_is_found_and_ends_with_an_error():
    with collect_problems() as outer:
        with refused(ModelError), collect_problems(sums_only=True) as inner:
            report("inner", is_sum=True)
            raise ModelError("stop")
        assert report("outer")
    assert ([p.text for p in outer], [p.text for p in inner]) == (["outer"], ["inner"])
    assert not is_collecting()


def test_another_thread_collects_for_itself():
    told = []
    with collect_problems() as problems:
        thread = threading.Thread(target=lambda: told.append(report("elsewhere")))
        thread.start()
        thread.join()
    assert (told, problems) == ([False], [])


def test_sums_are_put_right_in_every_part_of_a_model():
    with collect_problems(sums_only=True) as problems:
        model = POMDP([[[1, 1], [0, 0.5]]], [[[3, 1], [1, 1]]], np.zeros((2, 1)), discount=0.9, initial_belief=[1, 3])
    assert len(problems) == 5
    assert all(problem.is_sum for problem in problems)
    assert model.transition_matrix(0).tolist() == [[0.5, 0.5], [0, 1]]
    assert model.observation_matrix(0).tolist() == [[0.75, 0.25], [0.5, 0.5]]
    assert model.initial_belief.tolist() == [0.25, 0.75]


@pytest.mark.parametrize("sparse", [False, True])
def test_events_that_sum_to_more_than_1_are_put_right_others_kept(sparse):
    told = np.zeros((1, 2, 2, 2))
    told[0, :, 0, 0] = [1.5, 0.5]
    told[0, :, 0, 1] = [0.5, 0.25]
    told[0, :, 1, 1] = [0, 3]
    options = {"discount": 0.9, "event_observations": True, "sparse": sparse}
    transitions = [[[0.5, 0.5], [0, 1]]]
    with collect_problems(sums_only=True) as problems, pytest.warns(UserWarning, match="as little as 0.75"):
        model = POMDP(transitions, told, np.zeros((2, 1)), **options)
    assert [problem.text[-45:] for problem in problems] == [
        "transition from '0' to '0' sum to 2, more than 1"[-45:],
        "transition from '1' to '1' sum to 3, more than 1"[-45:],
    ]
    assert [dense(model.joint_matrix(0, o)).tolist() for o in range(2)] == [
        [[0.375, 0.25], [0, 0]],
        [[0.125, 0.125], [0, 1]],
    ]
    tracker = BeliefTracker(model)
    tracker.reset([0, 1])
    assert tracker.update(0, 1) == 1
    assert told[0, 1, 1, 1] == 3  # what was handed in stays as it is


def network(initial, moves):
    now, later = ([Node(role, place) for place in range(2)] for role in ("state", "next_state"))
    return TwoSliceNetwork(
        Space([Factor("x", 2), Factor("y", 2)]),
        Space.single("act", 1),
        initial=[Table([now[0]], initial), Table([now[1]], [1, 0])],
        transitions=[Table([now[0], later[0]], moves), Table([*now, *later], np.full((2, 2, 2, 2), 0.5))],
    )


def test_factors_that_nothing_is_possible_for_are_told_and_the_rest_is_read_on():
    with collect_problems() as problems:
        model = FactoredMDP(network([0, 0], np.zeros((2, 2))), discount=0.9).flatten()
    assert [problem.text for problem in problems][:3] == [
        "the probabilities of 'x': they sum to 0, not to 1",
        'the probabilities of "x\'" given x=0: they sum to 0, not to 1',
        'the probabilities of "x\'" given x=1: they sum to 0, not to 1',
    ]
    assert model.initial_belief.sum() == model.transition_matrix(0).sum(axis=1).max() == 1


@pytest.mark.parametrize("sparse", [False, True])
def test_events_that_are_never_told_of_are_allowed(sparse):
    now, later = Node("state", 0), Node("next_state", 0)
    first, second = Node("observation", 0), Node("observation", 1)
    silent = TwoSliceNetwork(
        Space.single("x", 2),
        Space.single("act", 1),
        Space([Factor("left", 2), Factor("right", 3)]),
        initial=[Table([now], [1, 0])],
        transitions=[Table([later], [0.5, 0.5])],
        observation=[Table([now, first], np.zeros((2, 2))), Table([first, second], np.full((2, 3), 1 / 3))],
    )
    with pytest.warns(UserWarning, match="as little as 0;"):
        model = FactoredPOMDP(silent, discount=0.9, sparse=sparse).flatten()
    assert [dense(model.event_matrix(0, o)).sum() for o in range(6)] == [0] * 6
    tracker = BeliefTracker(model)
    assert [tracker.update(0, o) for o in range(6)] == [0] * 6
    assert tracker.update(0, None) == 1
