"""The model that is estimated anew."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import visits, wandering
from hypothesis import given, strategies as st

import mdm
from mdm.estimation import chains_of, counted, reestimated, transition_rows
from mdm.estimation.reestimation import blended, possible
from mdm.estimation.rows import row_of
from mdm.models import MDP, POMDP, Factor, FactoredMDP, Node, Space, Table, TwoSliceNetwork

T = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]])


def estimated(model, states, kind="steps", **options):
    rows = transition_rows(model, counted(chains_of(visits(states), kind=kind).stays()), kind)
    return reestimated(model, rows, **options)


@pytest.mark.parametrize("sparse", [False, True])
def test_the_old_row_weighs_as_much_as_one_visit(sparse):
    model = MDP([T, T], np.zeros((3, 2)), discount=0.9, sparse=sparse, states=["a", "b", "c"], actions=["x", "y"])
    new = estimated(model, [0, 0, 0, 1, 1])
    assert new.transition("x", "a").tolist() == [2.5 / 4, 1.5 / 4, 0]
    assert new.transition("x", "b").tolist() == [0, 0.75, 0.25]
    assert new.transition("x", "c").tolist() == [1, 0, 0]  # was not visited
    assert new.transition("y", "a").tolist() == [0.5, 0.5, 0]
    assert (new.state_space, new.action_space, new.discount) == (model.state_space, model.action_space, 0.9)
    assert new.is_sparse == sparse


@given(st.lists(st.integers(0, 50), min_size=3, max_size=3))
def test_what_was_possible_stays_possible(counts):
    row = row_of(0, 0, np.arange(3), np.array([0.2, 0.3, 0.5]), dict(enumerate(counts)))
    assert (blended(row) > 0).all()
    assert blended(row).sum() == pytest.approx(1)


def test_jumps_leave_the_probability_of_staying_as_it_was():
    model = MDP([[[0.8, 0.1, 0.1], [0, 1, 0], [0, 0, 1]]], np.zeros((3, 1)), discount=0.9)
    told = chains_of([*visits([0, 1]), *visits([0, 1]), *visits([0, 2])])
    rows = transition_rows(model, counted(told.stays()), "jumps")
    new = reestimated(model, rows)
    assert new.transition(0, 0) == pytest.approx([0.8, 0.2 * 2.5 / 4, 0.2 * 1.5 / 4])


def test_rewards_of_outcomes_are_expected_anew():
    outcomes = np.arange(9, dtype=float).reshape(1, 3, 3)
    model = MDP([T], outcomes, discount=0.9)
    new = estimated(model, [0, 0, 0, 1])
    expected = MDP([new.transition_matrix(0)], outcomes, discount=0.9)
    assert new.rewards == pytest.approx(expected.rewards)
    assert new.rewards[0, 0] != model.rewards[0, 0]
    assert new.reward(0, 0, 1) == 1.0


def test_rewards_of_observations_are_expected_anew():
    outcomes = np.arange(12, dtype=float).reshape(1, 2, 2, 3)
    transitions, told = [[0.5, 0.5], [0.5, 0.5]], [[0.2, 0.3, 0.5], [0.6, 0.4, 0.0]]
    model = POMDP([transitions], [told], outcomes, discount=0.9)
    rows = [row_of(0, 1, np.array([0, 1]), np.array([0.6, 0.4]), {0: 1, 1: 5})]
    new = reestimated(model, [], rows)
    expected = POMDP([transitions], [new.observation_matrix(0)], outcomes, discount=0.9)
    assert new.observation(0, 1).tolist() == pytest.approx([1.6 / 7, 5.4 / 7, 0])
    assert new.rewards == pytest.approx(expected.rewards)


def test_observations_of_events_and_false_negatives_stay():
    events = np.full((1, 2, 2, 2), 0.5)
    model = POMDP([np.full((2, 2), 0.5)], events, np.zeros((2, 1)), discount=0.9, event_observations=True)
    new = reestimated(model.with_false_negatives(0), [row_of(0, 0, np.arange(2), np.array([0.5, 0.5]), {0: 3})])
    assert (new.false_negative, new.event_observations) == (0, True)
    assert new.event_matrix(0, 1).tolist() == [[0.5, 0.5]] * 2


def test_a_model_estimated_from_many_decisions_is_the_true_one_and_can_be_solved_and_saved(tmp_path):
    truth = np.array([[0.1, 0.9, 0.0], [0.0, 0.3, 0.7], [1.0, 0.0, 0.0]])
    model = MDP([T], [[0.0], [0.0], [1.0]], discount=0.9)
    new = estimated(model, wandering(truth, 20_000))
    assert np.abs(new.transition_matrix(0) - truth).max() < 0.02
    mdm.save_model(new, tmp_path / "new.npz")
    again = mdm.load_model(tmp_path / "new.npz")
    assert mdm.solve(again).policy.action(0) == 0


def of_visits(model, visits):
    model.visits = np.array(visits, float)
    return model


def test_models_that_records_leave_possible_vary_by_the_visits_to_a_row():
    model = of_visits(MDP([T, T], np.zeros((3, 2)), discount=0.9), [[999, 0], [0, 0], [0, 0]])
    drawn = [[each.transition(action, 0, 0) for action in (0, 1)] for each in possible(model, 500)]
    assert np.mean(drawn, axis=0) == pytest.approx([0.5, 0.5], abs=0.06)
    assert np.std(drawn, axis=0) == pytest.approx([0.5 / np.sqrt(1001), 0.5 / np.sqrt(2)], rel=0.15)  # of Beta
    assert all((each.transition_matrix(0)[T == 0] == 0).all() for each in possible(model, 3))


def test_of_a_network_the_rows_of_factors_are_drawn_once():
    """Two lamps, of which one fails whatever the other does: one number in four rows."""
    lamps = [Node("state", place) for place in (0, 1)], [Node("next_state", place) for place in (0, 1)]
    space, press = Space(Factor(name, ["on", "off"]) for name in "ab"), Space.single("robot", ["wait"])
    fails = [[0.9, 0.1], [0.4, 0.6]], [[0.7, 0.3], [0.2, 0.8]]
    transitions = [Table([now, later], row) for now, later, row in zip(*lamps, fails, strict=True)]
    network = TwoSliceNetwork(
        space, press, initial=[Table([now], [1, 0]) for now in lamps[0]], transitions=transitions, utilities=[]
    )
    (new,) = possible(of_visits(FactoredMDP(network, discount=0.9), [[9], [9], [9], [9]]), 1)
    first = new.transition_matrix(0).reshape(4, 2, 2).sum(axis=2)
    assert first[0] == pytest.approx(first[1])
    assert first[2] == pytest.approx(first[3])
    assert first[0] != pytest.approx([0.9, 0.1])
