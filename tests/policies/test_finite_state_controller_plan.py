"""Plans under way, from node to node."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import ModelError
from mdm.policies import FiniteStateController, JointController
from mdm.policies.finite_state_controller import Walk

# A plan of two decisions, and one that goes round for ever but has no edge for its observation 1 at node 1.
PLAN = FiniteStateController([0, 1, 2], [[1, 2], [None, None], [None, None]], 3)
ROUND = FiniteStateController([1, 0], [[1, 0, 1], [0, None, 1]], 2, start=1)


@st.composite
def controllers(draw, holes=True):
    nodes, observations, actions = (draw(st.integers(1, 4)) for _ in range(3))
    after = st.integers(0, nodes - 1)
    row = st.lists(st.none() | after if holes else after, min_size=observations, max_size=observations)
    return FiniteStateController(
        draw(st.lists(st.integers(0, actions - 1), min_size=nodes, max_size=nodes)),
        draw(st.lists(row, min_size=nodes, max_size=nodes)),
        actions,
        start=draw(after),
    )


@given(st.lists(controllers(), min_size=1, max_size=3), st.data())
def test_a_team_walks_as_its_agents_do_alone(team, data):
    joint = JointController(team)
    together, alone = joint.information(None), [each.information(None) for each in team]
    sizes = [each.num_observations for each in team]
    for _ in range(data.draw(st.integers(0, 5))):
        parts = tuple(data.draw(st.none() | st.integers(0, size - 1)) for size in sizes)
        observation = parts if None in parts else int(np.ravel_multi_index(parts, sizes))
        moved = [each.update(None, part) for each, part in zip(alone, parts, strict=True)]
        assert together.update(None, observation) == min(moved)
        assert together.current == tuple(each.current[0] for each in alone)
        actions = [plan.action(each.current) for plan, each in zip(team, alone, strict=True)]
        assert joint.action(together.current) == np.ravel_multi_index(actions, [each.num_actions for each in team])
        assert together.ended == any(each.ended for each in alone)


def test_a_plan_ends_at_nodes_that_nothing_follows():
    walk = PLAN.information(None)
    assert (walk.current, PLAN.action(walk.current), walk.ended) == ((0,), 0, False)
    assert walk.update(0, 1) == 1
    assert (walk.current, PLAN.action(walk.current), walk.ended) == ((2,), 2, True)
    assert walk.update(2, 0) == 0
    walk.reset()
    assert walk.current == (0,)


def test_it_stays_where_nothing_is_observed_and_where_no_edge_leads():
    walk = ROUND.information(None)
    assert walk.update(0, None) == 1
    assert walk.update(0, 1) == 0
    assert walk.current == (1,)
    assert walk.update(0, (0,)) == 1
    assert walk.current == (0,)


def test_a_belief_chooses_the_first_node_where_values_are_known():
    known = FiniteStateController([0, 1], [[0], [1]], values=[[1, 0], [0, 1]]).information(None)
    known.reset(np.array([0.4, 0.6]))
    assert known.current == (1,)
    known.reset()
    assert known.current == (0,)
    several = JointController([FiniteStateController([0, 1], [[0], [1]], values=[[1, 0], [0, 1]])] * 2)
    for without in (JointController([PLAN, ROUND]), PLAN, several):
        with refused(ModelError):
            without.information(None).reset(np.array([0.4, 0.6]))


def test_a_snapshot_goes_on_from_its_nodes():
    walk = JointController([PLAN, ROUND]).information(None)
    walk.update(None, (1, 0))
    held = walk.snapshot()
    walk.reset()
    walk.restore(held)
    assert walk.current == (2, 0)


@pytest.mark.parametrize(
    ("observation", "words"),
    [
        (6, "there is no observation 6; the controller's 6 count from 0"),
        (-1, "there is no observation -1"),
        ((0,), "an observation has 2 components, not 1"),
        ((0, 3), "there is no observation 3; the controller's 3 count from 0"),
    ],
)
def test_what_cannot_be_observed_is_refused_and_moves_nobody(observation, words):
    walk = Walk([PLAN, ROUND])
    with pytest.raises(ModelError) as caught:
        walk.update(None, observation)
    assert words in str(caught.value)
    assert walk.current == (0, 1)
