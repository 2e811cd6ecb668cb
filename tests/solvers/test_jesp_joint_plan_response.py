"""Best responses, against all trees that an agent could take; and rows that are the same."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from teams import best_of_all, team

from mdm.solvers.jesp import Team, best_response, merged, plan_value, random_plan, solve_as_one


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(0, 1), st.booleans())
@settings(max_examples=25)
def test_no_tree_of_the_agent_is_better(seed, horizon, agent, events):
    dynamics = Team(team(seed, states=3, events=events))
    plan = random_plan(dynamics, horizon, np.random.default_rng(seed))
    value, tree = best_response(dynamics, plan, agent)
    assert plan_value(dynamics, [tree if other == agent else plan[other] for other in range(2)]) == pytest.approx(value)
    sizes = [len(step) for step in plan[agent]]
    for choice in itertools.product(range(2), repeat=sum(sizes)):
        own = np.split(np.array(choice), np.cumsum(sizes)[:-1])
        assert plan_value(dynamics, [own if other == agent else plan[other] for other in range(2)]) <= value + 1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_a_team_that_shares_all_it_observes_bounds_every_plan(seed):
    model = team(seed)
    stages = solve_as_one(Team(model, as_one=True), 2)
    assert stages[0].values.max() >= best_of_all(model, 2) - 1e-9
    assert stages[1].chances.size == 0
    reached = stages[0].following
    assert ((reached >= 0) == (stages[0].chances > 0)).all()


def test_it_may_be_broken_off_and_what_is_too_large_is_not_begun():
    dynamics = Team(team(1))
    plan = random_plan(dynamics, 3, np.random.default_rng(0))
    asked = iter([True, True, False])
    assert best_response(dynamics, plan, 0, lambda: next(asked)) is None
    assert solve_as_one(Team(team(1), as_one=True), 30) is None


@given(st.lists(st.lists(st.sampled_from([0.0, -0.0, 0.5, 1.0]), min_size=3, max_size=3), min_size=1, max_size=20))
def test_merged_rows_are_each_there_once(rows):
    array = np.array(rows)
    first, which = merged(array)
    np.testing.assert_array_equal(array[first][which], array)
    assert len(first) == len({tuple(row) for row in array.tolist()})
