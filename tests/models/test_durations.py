"""Durations, against direct iteration over time and exact moments."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import random_mdp
from sentences import refused

import mdm
from mdm.errors import ModelError
from mdm.models import MDP, Durations, in_time
from mdm.solvers import exact_values


def in_seconds(model):
    """Return the same model with its discount of a second."""
    return model.with_discount(model.discount, of="second")


def direct_values(model, means, stages):
    """Iterate over decisions: V(s) = max_a R(s, a) + D(s, a) sum_s' T(s, a, s') V(s')."""
    rate = -math.log(model.discount)
    count, actions = len(model.state_space), len(model.action_space)
    values = [0.0] * count
    matrices = [
        np.asarray(
            model.transition_matrix(a).todense()
            if hasattr(model.transition_matrix(a), "todense")
            else model.transition_matrix(a)
        )
        for a in range(actions)
    ]
    while True:
        q = [
            [
                model.rewards[s, a]
                + (stages[s][a] / (stages[s][a] + rate * means[s][a])) ** stages[s][a] * float(matrices[a][s] @ values)
                for a in range(actions)
            ]
            for s in range(count)
        ]
        new = [max(row) for row in q]
        if max(abs(a - b) for a, b in zip(new, values, strict=True)) < 1e-13:
            return new, q
        values = new


@given(seed=st.integers(0, 10**6), states=st.integers(1, 5), random=st.randoms(use_true_random=False))
def test_solving_by_the_transformation_equals_direct_iteration(seed, states, random):
    model, _ = random_mdp(seed, states=states)
    model, actions = in_seconds(model), len(model.action_space)
    means = [[random.uniform(0.1, 20) for _ in range(actions)] for _ in range(states)]
    stages = [[random.choice([1, 2, 9]) for _ in range(actions)] for _ in range(states)]
    solution = mdm.solve(model, "policy-iteration", durations=Durations(means, stages), gap=1e-12)
    values, q = direct_values(model, means, stages)
    assert solution.policy.num_states == states
    assert [solution.policy.value(s) for s in range(states)] == pytest.approx(values, abs=1e-9)
    for state in range(states):
        assert q[state][solution.policy.action(state)] == pytest.approx(max(q[state]), abs=1e-9)


@given(seed=st.integers(0, 10**6), mean=st.floats(0.2, 5))
def test_where_all_actions_take_alike_it_is_the_model_with_another_discount(seed, mean):
    model = in_seconds(random_mdp(seed, states=3)[0])
    rate = -math.log(model.discount)
    same = mdm.solve(model.with_discount(1 / (1 + rate * mean), of="step"), gap=1e-9)
    assert mdm.solve(model, durations=Durations(mean), gap=1e-9).upper == pytest.approx(same.upper, abs=1e-6)


def test_vectors_of_a_model_with_observations_are_those_of_its_own_states():
    model = in_seconds(mdm.problems.tiger())
    rate = -math.log(model.discount)
    mean = (1 / 0.8 - 1) / rate
    solution = mdm.solve(model, durations=Durations(mean), gap=1e-3)
    same = mdm.solve(model.with_discount(0.8, of="step"), gap=1e-3)
    assert solution.policy.mismatch(model) is None
    assert solution.lower == pytest.approx(same.lower, abs=2e-3)
    belief = [0.5, 0.5]
    assert solution.policy.action(np.array(belief)) == same.policy.action(np.array(belief))


def test_what_cannot_be_is_refused():
    model = mdm.problems.forest()
    with refused(ModelError):
        Durations([1.0, -1.0])
    with refused(ModelError):
        Durations(math.nan)
    with refused(ModelError):
        Durations([1.0] * 3, stages=[1, 2])
    with refused(ModelError):
        Durations(np.ones((0, 2)))
    with refused(ModelError):
        Durations(1.0, stages=1.5)
    with refused(ModelError):
        in_time(model, Durations([1.0] * 5))
    with refused(ModelError):
        in_time(model.with_discount(1.0), Durations(1.0))
    with refused(ModelError):
        mdm.solve(in_seconds(mdm.problems.dec_tiger(discount=0.9)), "jesp", horizon=2, durations=Durations(1.0))
    with refused(ModelError):
        Durations(1.0, rates=math.inf)
    with refused(ModelError):
        Durations([1.0] * 3, rates=[1, 2])
    with refused(ModelError):
        Durations([1.0, 2.0], rates=[[1, 2]] * 4).table(model)
    with refused(ModelError):
        Durations(1.0, of="minute")


# -- Rewards by time ---------------------------------------------------------------------------------------------------


def earned_by_time(rate, mean, stages, interest):
    """Return the expected integral of a discounted rate over an Erlang time, by midpoints over its distribution."""
    scipy_stats = pytest.importorskip("scipy.stats")
    shares = (np.arange(20_000) + 0.5) / 20_000
    times = scipy_stats.gamma.ppf(shares, stages, scale=mean / stages)
    return rate * float(np.mean((1 - np.exp(-interest * times)) / interest))


@pytest.mark.parametrize(("of", "unit"), [("second", "second"), (10.0, "second"), ("step", "step"), (10.0, "step")])
def test_rewards_by_time_are_their_discounted_integral(of, unit):
    model = mdm.problems.forest().with_discount(0.9, of=of)
    durations = Durations([[4.0, 9.0]] * 3, [1, 3], [[1.0, -2.0], [0.5, 0.0], [0.0, 3.0]], of=unit)
    interest = -math.log(0.9) / (10 if (of, unit) == (10.0, "second") else 1)
    paid = durations.rewards(model) - model.rewards
    for state, action in np.ndindex(3, 2):
        expected = earned_by_time(durations.rates[state, action], (4, 9)[action], (1, 3)[action], interest)
        assert paid[state, action] == pytest.approx(expected, rel=1e-3)


def test_where_an_action_is_not_available_the_first_one_that_is_stands_in_with_its_time():
    available = [[True, False], [True, True], [False, True]]
    model = MDP([np.eye(3)] * 2, np.zeros((3, 2)), discount=0.9, available=available)
    durations = Durations([3.0, 5.0], rates=[1.0, 2.0], of="step")
    discounts, rewards = durations.discounts(model), durations.rewards(model)
    for state, action in ((0, 0), (2, 1)):
        assert discounts[state].tolist() == [discounts[1, action]] * 2
        assert rewards[state].tolist() == [rewards[1, action]] * 2


@pytest.mark.parametrize("scale", [0.1, 1.0])
def test_a_wait_costs_by_its_time_and_a_drive_lasts_what_it_lasts(scale):
    """Solved, exact and simulated values agree, and the costs by time decide which way is taken."""
    gone = [[0.0, 1.0], [0.0, 1.0]]
    names = {"states": ["call", "done"], "actions": ["dear", "slow"]}
    model = MDP([gone, gone], [[-5.0, 0.0], [0.0, 0.0]], discount=0.99, **names).with_discount(0.99, of="second")
    durations = Durations([[10.0, 40.0]] * 2, 9, [[-scale, -scale], [0.0, 0.0]])
    solution = mdm.solve(model, durations=durations, gap=1e-9)
    chosen = solution.policy.action(0)
    assert chosen == (0 if scale == 1.0 else 1)
    values = exact_values(model, solution.policy, durations=durations)
    expected = (-5, 0)[chosen] + earned_by_time(-scale, (10, 40)[chosen], 9, -math.log(0.99))
    assert values[0] == pytest.approx(expected, rel=1e-3)
    assert solution.upper == pytest.approx(model.initial_belief @ values, abs=1e-6)
    told = mdm.evaluate(model, solution.policy, episodes=2_000, seed=1, durations=durations)
    assert abs(told.mean - solution.upper) < 4 * told.standard_error + 1e-9
