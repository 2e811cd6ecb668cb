"""Plans of a few decisions, against recursion over all that can happen."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st
from perseus_models import SEEDS, SMALL, parts, reachable, recursion
from sentences import refused

from mdm import ModelError
from mdm.problems import tiger
from mdm.solvers import Limits, controller_values
from mdm.solvers.perseus import perseus


@given(SMALL, SEEDS, st.integers(1, 3), st.booleans())
@settings(max_examples=30)
def test_plans_are_optimal_at_all_beliefs_that_can_be_reached(model, seed, horizon, misses):
    del seed
    missed = 0 if misses and len(model.observation_space) > 1 else None
    if missed is not None or model.event_observations:
        model = model.with_discount(min(model.discount, 0.9))
    model = model.with_false_negatives(missed)
    each = parts(model, missed)
    beliefs = reachable(each, model.initial_belief, horizon - 1)
    solution = perseus(model, beliefs=beliefs, horizon=horizon, limits=Limits(gap=0))
    best = recursion(each, model.discount, model.initial_belief, horizon)
    slack = 1e-9 * (1 + abs(best))
    assert solution.lower == pytest.approx(best, abs=slack)
    assert solution.upper >= best - slack
    plan = solution.policy
    assert plan.horizon == horizon
    worth = controller_values(model, plan)[plan.start] @ model.initial_belief
    assert worth == pytest.approx(solution.lower, abs=slack)


def test_a_plan_is_whole_wherever_it_is_stopped():
    seconds = iter(range(10**9))
    solution = perseus(tiger(), beliefs=100, horizon=9, limits=Limits(time=25, clock=lambda: next(seconds)))
    assert solution.reason == "time"
    assert solution.policy.horizon == 9
    worth = controller_values(tiger(), solution.policy)[solution.policy.start] @ tiger().initial_belief
    assert worth == pytest.approx(solution.lower)
    assert perseus(tiger().with_discount(1), beliefs=100, horizon=9).lower > solution.lower


def test_a_horizon_that_no_plan_could_have_is_refused():
    with refused(ModelError):
        perseus(tiger(), horizon=10**12)
