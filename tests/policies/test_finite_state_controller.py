"""Controllers of nodes and edges."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import ModelError
from mdm.policies import FiniteStateController

SUCCESSORS = [[2, 1], [0, None], [0, 0]]


def controller(**given):
    return FiniteStateController([0, 1, 2], SUCCESSORS, **given)


def test_a_node_tells_its_action_and_what_follows():
    graph = controller()
    assert (graph.num_nodes, graph.num_actions, graph.num_observations, graph.num_states) == (3, 3, 2, None)
    assert [graph.action_at(node) for node in range(3)] == [0, 1, 2] == list(graph.actions)
    assert graph.next_node(0, 1) == 1
    assert graph.next_node(1, 1) is None
    assert graph.successors == ((2, 1), (0, None), (0, 0))
    assert graph.start == 0


def test_values_choose_the_first_node():
    graph = controller(values=[[3, 3], [0, 5], [5, 0]], start=1)
    assert [graph.start_node(np.array(belief)) for belief in ([0.5, 0.5], [0, 1], [1, 0])] == [0, 1, 2]
    assert graph.value(np.array([0.9, 0.1])) == 4.5
    assert graph.num_states == 2
    assert graph.start == 1


def test_of_nodes_with_equal_values_the_first_is_chosen():
    assert controller(values=np.ones((3, 2))).start_node(np.array([0.5, 0.5])) == 0


def test_arrays_and_sequences_give_the_same():
    graph = FiniteStateController(np.array([1, 0]), np.array([[1], [0]]))
    assert (graph.actions, graph.successors) == ((1, 0), ((1,), (0,)))
    assert all(type(number) is int for number in (*graph.actions, *graph.successors[0]))


@pytest.mark.parametrize(
    ("successors", "start", "horizon"),
    [
        ([[None]], 0, 1),
        ([[1], [None]], 0, 2),
        ([[1], [None]], 1, 1),
        ([[0]], 0, None),
        ([[1], [1]], 0, None),
        ([[1, 2], [2, None], [None, 3], [None, None]], 0, 4),
        ([[None, None], [1, 0]], 0, 1),  # a circle that is never reached
        ([[1, None], [None, 0]], 0, None),
    ],
)
def test_the_longest_way_is_the_horizon(successors, start, horizon):
    assert FiniteStateController([0] * len(successors), successors, start=start).horizon == horizon


def test_where_any_node_may_be_the_first_every_way_counts():
    successors = [[None, None], [1, 0]]
    assert FiniteStateController([0, 0], successors, values=np.zeros((2, 3))).horizon is None
    assert FiniteStateController([0, 0], [[None], [0]], values=np.zeros((2, 3))).horizon == 2


def test_a_node_that_nothing_follows_is_the_last():
    graph = FiniteStateController([0, 0], [[1, None], [None, None]])
    assert [graph.is_last(node) for node in range(2)] == [False, True]
    with refused(ModelError):
        graph.is_last(2)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: FiniteStateController([], []), "0 nodes' actions"),
        (lambda: FiniteStateController([0], []), "1 nodes' actions, but 0 rows"),
        (lambda: FiniteStateController([0, -1], [[0], [0]]), "node 1 is for action -1"),
        (lambda: FiniteStateController([0, 0.5], [[0], [0]]), "node 1 is for action 0.5"),
        (lambda: FiniteStateController([0, 3], [[0], [0]], 3), "the actions are 0 to 2"),
        (lambda: FiniteStateController([0, 0], [[0], [0, 1]]), "node 1 has 2 successors, but node 0 has 1"),
        (lambda: FiniteStateController([0, 0], [[0], [2]]), "node 1 is followed by node 2 after observation 0"),
        (lambda: FiniteStateController([0, 0], [[0], [-1]]), "followed by node -1"),
        (lambda: controller(start=3), "there is no node 3"),
        (lambda: controller(values=[[1, 2]]), "nodes x states array"),
        (lambda: controller(values=[1, 2, 3]), "nodes x states array"),
        (lambda: controller(values=[[1], [np.nan], [2]]), "value of node 1 is not finite"),
        (lambda: controller().action_at(3), "there is no node 3"),
        (lambda: controller().action_at(-1), "there is no node -1"),
        (lambda: controller().next_node(5, 0), "there is no node 5"),
        (lambda: controller().next_node(0, 2), "there is no observation 2"),
        (lambda: controller().value(np.array([1.0])), "no values"),
        (lambda: controller(values=np.ones((3, 2))).value(np.array([1.0])), "beliefs of 2 numbers"),
        (lambda: controller(values=np.ones((3, 2))).start_node(np.ones((2, 1))), "not of shape (2, 1)"),
    ],
)
def test_what_is_wrong_is_said(make, words):
    with pytest.raises(ModelError) as caught:
        make()
    assert words in str(caught.value)
