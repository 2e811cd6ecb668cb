"""What policies compare: their own values, to the last digit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from nearest import drawn, random_alpha, random_masked, random_mixed
from sentences import refused

import mdm
from mdm import ModelError, problems
from mdm.explanation import Case
from mdm.explanation.influence import margin, scores_at, second
from mdm.policies import (
    BeliefPolicy,
    DeterministicPolicy,
    FiniteStateController,
    QTable,
    StagedPolicy,
    StochasticPolicy,
)
from mdm.solvers.online import TreeSearch

SEEDS = st.integers(0, 2**32 - 1)


def at(policy, x, belief=None):
    """Return what a policy compares at an information state."""
    return scores_at(Case(policy, None, None, None, None, 0, 0, x), x, belief)


@given(SEEDS, st.sampled_from([random_alpha, random_masked, random_mixed]))
def test_values_are_the_policys_own(seed, make):
    random = np.random.default_rng(seed)
    policy = make(random, int(random.integers(2, 6)))
    belief = drawn(random, policy.num_states)
    if make is random_mixed:
        belief = np.zeros(policy.num_states)
        belief[policy.states[random.integers(3)]] = drawn(random, policy.states.shape[1])
    found = at(policy, belief)
    assert found.by == "value"
    assert found.numbers == pytest.approx(policy.q_values(belief), abs=1e-12)
    assert found.numbers.max() == pytest.approx(policy.value(belief), abs=1e-12)
    assert found.numbers[policy.action(belief)] == found.numbers.max()


def test_votes_where_what_is_observed_is_open():
    policy = random_mixed(np.random.default_rng(0), 2)
    belief = np.full(6, 1 / 6)
    found = at(policy, belief)
    assert found.by == "vote"
    assert found.numbers.sum() == pytest.approx(1)
    assert found.numbers.argmax() == policy.action(belief)


@given(SEEDS)
def test_tables(seed):
    random = np.random.default_rng(seed)
    values = random.normal(size=(2, 3, 4))
    staged, table = StagedPolicy(values), QTable(values[1])
    for state in range(3):
        assert at(table, state).numbers.max() == table.value(state)
        controller = mdm.Controller(staged)
        for stage in range(2):
            step = controller.see(state)
            assert scores_at(step.case(), step.at, None).numbers.tolist() == values[stage, state].tolist()
            assert margin(values[stage, state], step.action) >= 0
    chances = random.dirichlet(np.ones(3), size=2).T
    assert at(StochasticPolicy(chances), 1) == ("chance", pytest.approx(chances[:, 1]), None, None)
    assert at(DeterministicPolicy([0, 1]), 1) is None


def test_the_nodes_of_a_plan():
    """The value of the present node stands for its action, also where another node of it is better."""
    plan = FiniteStateController([0, 0, 1], [[0], [1], [2]], 3, values=[[1, 0], [4, 0], [2, 2]])
    belief = np.array([0.5, 0.5])
    assert at(plan, (0,), belief=belief).numbers.tolist() == [0.5, 2, -np.inf]
    assert at(plan, (2,), belief=belief).numbers.tolist() == [2, 2, -np.inf]
    assert at(plan, (2,)) is None


def test_a_search_once_more():
    model = problems.tiger()
    search = TreeSearch(model, expansions=50, seed=1)
    belief = np.array([0.85, 0.15])
    found, same = at(search, belief), at(search, belief)
    assert (found.by, found.effort) == ("bound", 50)
    assert found.numbers.tolist() == same.numbers.tolist() == search.q_values(belief).tolist()
    assert (found.upper >= found.numbers).all()
    assert found.numbers.argmax() == search.action(belief)


def test_policies_of_ones_own():
    class Cautious(BeliefPolicy):
        num_states, num_actions = 2, 2

        def action(self, belief):
            return int(belief[0] > 0.9)

    class Weighing(Cautious):
        def q_values(self, belief):
            return [belief[1], belief[0]]

    assert at(Cautious(), np.array([0.5, 0.5])) is None
    assert at(Weighing(), np.array([0.25, 0.75])).numbers.tolist() == [0.75, 0.25]


def test_the_second_and_the_margin():
    values = np.array([1.0, 3.0, 3.0, -np.inf])
    assert (second(values, 1), margin(values, 1)) == (2, 0.0)
    assert (second(values, 0), margin(values, 0)) == (1, -2.0)
    assert (second(values, 3), margin(values, 3)) == (1, None)
    assert (second(values[:1], 0), margin(values[:1], 0)) == (None, None)
    with refused(ModelError):
        second(values, 4)
