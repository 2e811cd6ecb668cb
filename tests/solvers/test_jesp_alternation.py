"""JESP against a published optimum, and against plain recursion over everything that can happen."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sentences import refused
from teams import best_of_all, by_trees, team, worth

from mdm import ConfigError, ModelError
from mdm.formats import load_policy, save_policy
from mdm.models import POMDP, Factor, Space
from mdm.problems import dec_tiger, grid_small
from mdm.solvers import Limits, solve
from mdm.solvers.jesp import jesp

# -- Published optima ----------------------------------------------------------------------------------------------
# Those of shorter horizons are compared by the tests of the problems.


def test_a_published_optimum_is_found_and_proven():
    """F. A. Oliehoek, M. T. J. Spaan, C. Amato and S. Whiteson, JAIR 46, 2013."""
    solution = jesp(grid_small(discount=1.0), horizon=4, limits=Limits(gap=1e-9))
    assert solution.reason in {"exact", "gap"}
    assert solution.lower == pytest.approx(2.24158, abs=2e-5)
    assert solution.upper == pytest.approx(solution.lower, abs=1e-9)


def test_the_models_discount_applies():
    model = dec_tiger()
    solution = jesp(model.with_discount(0.5), horizon=2)
    assert solution.lower == pytest.approx(-2 - 0.5 * 2)  # listen, listen


def test_values_of_large_horizons_come_without_proof():
    model = dec_tiger()
    solution = jesp(model, horizon=6, restarts=3, search=0)
    assert solution.reason == "iterations"
    assert solution.lower < solution.upper < math.inf


# -- Brute force ---------------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.booleans(), st.integers(0, 40))
def test_the_bound_below_is_the_plans_value(seed, horizon, events, effort):
    model = team(seed, states=3, observations=2, events=events)
    solution = jesp(model, horizon=horizon, restarts=1, search=effort, limits=Limits(gap=0))
    assert solution.lower == pytest.approx(worth(model, horizon, by_trees(solution.policy)), abs=1e-9)
    assert solution.lower <= solution.upper


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_two_steps_are_solved_to_the_optimum(seed, events):
    model = team(seed, events=events)
    solution = jesp(model, horizon=2, restarts=1, limits=Limits(gap=0))
    assert solution.reason in {"exact", "gap"}
    assert solution.lower == pytest.approx(best_of_all(model, 2), abs=1e-9)


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_bounds_hold_however_early_the_search_ends(seed, effort):
    model = team(seed, states=3, discount=1.0)
    optimum = jesp(model, horizon=3, limits=Limits(gap=0))
    assert optimum.reason in {"exact", "gap"}
    early = jesp(model, horizon=3, restarts=1, search=effort, limits=Limits(gap=0))
    assert early.lower <= optimum.lower + 1e-9
    assert early.upper >= optimum.lower - 1e-9


def test_three_agents_are_solved_to_the_optimum():
    model = team(5, agents=3)
    solution = jesp(model, horizon=2, limits=Limits(gap=0))
    assert solution.policy.num_agents == 3
    assert solution.reason in {"exact", "gap"}
    assert solution.lower == pytest.approx(best_of_all(model, 2), abs=1e-9)


def test_one_agent_gets_its_optimum_at_the_first_response():
    model = team(3, agents=1, states=3)
    solution = jesp(model, horizon=3, limits=Limits(gap=1e-9))
    assert solution.reason == "gap"
    assert solution.lower == pytest.approx(worth(model, 3, by_trees(solution.policy)), abs=1e-9)


def test_sparse_models_give_the_same():
    model = team(11, states=4)
    sparse = POMDP(
        [model.transition_matrix(a) for a in range(4)],
        [model.observation_matrix(a) for a in range(4)],
        model.rewards,
        discount=model.discount,
        actions=model.action_space,
        observation_names=model.observation_space,
        initial_belief=model.initial_belief,
        sparse=True,
    )
    assert sparse.is_sparse
    first, second = (jesp(each, horizon=3, limits=Limits(gap=0)) for each in (model, sparse))
    assert first.lower == pytest.approx(second.lower, abs=1e-9)
    assert first.policy.controllers[0].actions == second.policy.controllers[0].actions


# -- Stopping ------------------------------------------------------------------------------------------------------


def test_an_interrupt_gives_the_best_plan_so_far():
    model = dec_tiger()
    limits = Limits(gap=0, progress=lambda progress: progress.iterations >= 5 and limits.interrupt())
    solution = jesp(model, horizon=4, limits=limits)
    assert solution.reason == "interrupted"
    assert solution.iterations == 5
    assert solution.lower == pytest.approx(worth(model, 4, by_trees(solution.policy)), abs=1e-9)


def test_an_interrupt_ends_the_search_too():
    model = dec_tiger()
    moments = itertools.count()
    solution = jesp(
        model, horizon=6, restarts=1, search=10**9, limits=Limits(gap=0, time=3000, clock=lambda: next(moments))
    )
    assert solution.reason == "time"
    assert solution.lower <= 10.38163 <= solution.upper


def test_time_that_is_up_at_once_still_gives_a_plan():
    model = dec_tiger()
    solution = jesp(model, horizon=3, limits=Limits(time=0))
    assert (solution.reason, solution.iterations) == ("time", 0)
    assert solution.policy.controllers[0].num_nodes == 7
    assert solution.lower == pytest.approx(worth(model, 3, by_trees(solution.policy)), abs=1e-9)


def test_memory_that_is_used_up_still_leaves_a_plan():
    model = dec_tiger()
    assert jesp(model, horizon=3, limits=Limits(memory=1)).reason == "memory"


def test_the_same_seed_gives_the_same_plan():
    model = team(8, states=3)
    first, second = (jesp(model, horizon=3, seed=4, search=0, restarts=2) for _ in range(2))
    assert [c.actions for c in first.policy.controllers] == [c.actions for c in second.policy.controllers]


# -- Refusals ------------------------------------------------------------------------------------------------------


def test_a_horizon_that_is_too_long_is_refused():
    with refused(ModelError):
        jesp(team(0), horizon=40)


def test_a_horizon_is_at_least_one_decision():
    with refused(ModelError):
        jesp(team(0), horizon=0)


def test_there_is_at_least_one_start():
    with refused(ConfigError):
        jesp(team(0), restarts=0)


def test_observations_are_one_for_each_agent():
    model = team(0)
    shared = POMDP(
        [model.transition_matrix(a) for a in range(4)],
        [model.observation_matrix(a) for a in range(4)],
        model.rewards,
        discount=1.0,
        actions=model.action_space,
    )
    with refused(ModelError):
        jesp(shared)


def test_events_that_go_unobserved_are_refused():
    told = np.full((4, 4, 2, 2), 0.2)
    with pytest.warns(match="observation"):
        silent = POMDP(
            np.full((4, 2, 2), 0.5),
            told,
            np.zeros((2, 4)),
            discount=1.0,
            actions=Space([Factor("a", 2), Factor("b", 2)]),
            observation_names=Space([Factor("a", 2), Factor("b", 2)]),
            event_observations=True,
        )
    with refused(ModelError):
        jesp(silent)


# -- Together with the rest ----------------------------------------------------------------------------------------


def test_a_plan_is_written_and_read_as_madp_does(tmp_path):
    model = dec_tiger()
    solution = solve(model, "jesp", horizon=3)
    for name in ("plan.policy", "plan.npz"):
        save_policy(solution.policy, tmp_path / name, model)
        again = load_policy(tmp_path / name, model)
        assert worth(model, 3, by_trees(again)) == pytest.approx(5.19081, abs=1e-5)
