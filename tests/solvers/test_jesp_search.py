"""The search for the best joint plan, against enumeration; and where its effort is used up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from teams import best_of_all, team

from mdm.solvers.jesp import PlanSearch, Team, plan_value, solve_as_one

NOTHING = -1e9


def search_of(model, horizon, effort, lower=NOTHING):
    return PlanSearch(Team(model), solve_as_one(Team(model, as_one=True), horizon), lower, effort)


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=15)
def test_the_plan_it_ends_with_is_the_best_of_all(seed, events):
    model = team(seed, events=events)
    search = search_of(model, 2, 10**6)
    bounds = [search.upper]
    while not search.done:
        search.expand()
        bounds.append(search.upper)
    best = best_of_all(model, 2)
    assert search.lower == pytest.approx(best, abs=1e-9)
    assert plan_value(Team(model), search.plan) == pytest.approx(best, abs=1e-9)
    assert (np.diff(bounds) <= 1e-9).all()
    assert min(bounds) >= best - 1e-9


def test_what_is_known_to_be_the_best_is_not_searched_for():
    model = team(3)
    search = search_of(model, 2, 10**6, lower=best_of_all(model, 2))
    while not search.done:
        search.expand()
    assert search.plan is None


def test_without_effort_a_partial_plan_stays_as_it_was():
    search = search_of(team(3), 2, 0)
    before = search.upper
    search.expand()
    assert (search.upper, search.done) == (before, False)
