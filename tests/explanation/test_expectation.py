"""What comes next, against the model's matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm import ModelError, problems
from mdm.explanation import Chance, expected_next
from mdm.explanation.expectation import likeliest
from mdm.models import POMDP
from mdm.policies import AlphaVectors, QTable

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_by_the_matrices(seed):
    random = np.random.default_rng(seed)
    states, seen = int(random.integers(1, 5)), int(random.integers(1, 5))
    model = POMDP(
        random.dirichlet(np.ones(states), size=(2, states)),
        random.dirichlet(np.ones(seen), size=(2, states)),
        np.zeros((states, 2)),
        discount=0.9,
    )
    belief = random.dirichlet(np.ones(states))
    step = mdm.Controller(AlphaVectors(random.normal(size=(2, states)), [0, 1]), model).start(belief)
    after = belief @ np.asarray(model.transition_matrix(step.action))
    observed = after @ np.asarray(model.observation_matrix(step.action))
    next_states, next_observations = expected_next(step.case(), belief)
    for found, chances, space in (
        (next_states, after, model.state_space),
        (next_observations, observed, model.observation_space),
    ):
        order = np.argsort(-chances)[:3]
        assert [each.probability for each in found] == pytest.approx(chances[order])
        assert {each.name for each in found} == {space.names[index] for index in order}


def test_of_an_mdp():
    model = problems.river_swim()
    step = mdm.Controller(QTable(np.zeros((6, 2))), model).see(2)
    certain = np.eye(6)[2]
    states, observations = expected_next(step.case(), certain, 6)
    row = model.transition(step.action, 2)
    assert {each.name: each.probability for each in states} == {
        model.state_space.names[at]: pytest.approx(row[at]) for at in np.flatnonzero(row)
    }
    assert observations == ()


def test_without_a_model():
    step = mdm.Controller(QTable(np.zeros((6, 2)))).see(2)
    with refused(ModelError):
        expected_next(step.case(), np.eye(6)[2])


def test_for_one_agent_of_a_team():
    step = mdm.Controller(QTable(np.zeros((6, 2)))).see(2)
    case = step.case()._replace(model=problems.tiger())
    with refused(ModelError):
        expected_next(case, np.eye(6)[2])


def test_the_likeliest_and_no_impossible_ones():
    pairs = [("a", 0.2), ("b", 0.0), ("c", 0.5), ("d", 0.3)]
    assert likeliest(pairs, 2) == (Chance("c", 0.5), Chance("d", 0.3))
    assert len(likeliest(pairs, 9)) == 3
