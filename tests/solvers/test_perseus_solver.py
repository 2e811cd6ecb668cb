"""Perseus against recursion over beliefs, known optima, MADP's own policies, and simulation."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from hypothesis import given, settings
from perseus_models import SEEDS, SMALL, events, parts, recursion
from sentences import refused

from mdm import ConfigError, ModelError
from mdm.models import POMDP
from mdm.policies import AlphaVectors
from mdm.problems import tiger
from mdm.solvers import Limits, solve
from mdm.solvers.perseus import perseus


def test_tiger_reaches_its_optimum():
    solution = perseus(tiger())
    assert solution.reason == "converged"
    assert 19.37 < solution.lower < 19.3722
    assert solution.policy.value(tiger().initial_belief) == pytest.approx(solution.lower)
    assert solution.upper > solution.lower
    lowers = [progress.lower for progress in solution.history]
    assert lowers == sorted(lowers)


@given(SMALL, SEEDS)
@settings(max_examples=25)
def test_bounds_enclose_the_optimum_and_policies_keep_their_promise(model, seed):
    model = model.with_discount(min(model.discount, 0.8))
    solution = perseus(model, beliefs=30, seed=seed, limits=Limits(iterations=6))
    each, depth = parts(model), 3
    ends = [float(pick(model.rewards)) / (1 - model.discount) for pick in (np.min, np.max)]
    low, high = (recursion(each, model.discount, model.initial_belief, depth, end) for end in ends)
    slack = 1e-9 * (1 + np.abs(ends).max())
    assert solution.lower <= high + slack
    assert solution.upper >= low - slack
    assert solution.lower <= solution.upper + slack
    policy = solution.policy
    assert policy.value(model.initial_belief) == pytest.approx(solution.lower, abs=slack)
    for belief in np.random.default_rng(seed).dirichlet(np.full(len(model.state_space), 0.5), size=10):
        earned, after = each[policy.action(belief)]
        ahead = sum(max(policy.vectors @ (belief @ matrix)) for matrix in after)
        assert policy.value(belief) <= belief @ earned + model.discount * ahead + slack


def test_the_same_seed_finds_the_same_policy():
    model = events(3)
    first, again, other = (solve(model, "perseus", iterations=5, beliefs=50, seed=seed).policy for seed in (1, 1, 2))
    assert np.array_equal(first.vectors, again.vectors)
    assert first.actions == again.actions
    assert first.vectors.shape != other.vectors.shape or not np.allclose(first.vectors, other.vectors)


def test_it_stops_when_it_is_told_to():
    def interrupt(progress):
        if progress.iterations == 3:
            signal.raise_signal(signal.SIGINT)

    solution = perseus(tiger(), limits=Limits(progress=interrupt))
    assert solution.reason == "interrupted"
    assert solution.iterations == 3
    assert isinstance(solution.policy, AlphaVectors)
    assert solution.lower > -20  # what listening for ever is worth
    seconds = iter(range(10**9))
    late = perseus(tiger(), beliefs=100, limits=Limits(time=60, gap=0, clock=lambda: next(seconds)))
    assert late.reason == "time"
    assert late.policy.value(tiger().initial_belief) == late.lower
    assert perseus(tiger(), beliefs=100, limits=Limits(iterations=0)).lower == pytest.approx(-20, abs=1e-2)
    assert perseus(tiger(), beliefs=100, limits=Limits(gap=150)).reason == "gap"
    assert perseus(tiger(), beliefs=100, limits=Limits(memory=1)).reason == "memory"


def test_refusals():
    model = tiger()
    with refused(ModelError):
        perseus(model.with_discount(1))
    with refused(ConfigError):
        perseus(model, beliefs=0)
    with refused(ConfigError):
        perseus(model, horizon=0)
    with refused(ModelError):
        perseus(model, beliefs=[[0.5, 0.5], [1, 1]])
    with refused(ModelError):
        perseus(POMDP([np.eye(2)], [np.eye(2)], [[1e308], [0]], discount=0.9))
    never = POMDP([np.eye(2)], [[[1, 0], [0, 1]]], [[1], [0]], discount=1.0)
    with refused(ModelError):
        perseus(never.with_false_negatives(0), horizon=2)
