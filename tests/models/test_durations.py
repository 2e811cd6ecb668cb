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
from mdm.models import Durations, in_time


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
    actions = len(model.action_space)
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
    model, _ = random_mdp(seed, states=3)
    rate = -math.log(model.discount)
    same = mdm.solve(model.with_discount(1 / (1 + rate * mean)), gap=1e-9)
    assert mdm.solve(model, durations=Durations(mean), gap=1e-9).upper == pytest.approx(same.upper, abs=1e-6)


def test_vectors_of_a_model_with_observations_are_those_of_its_own_states():
    model = mdm.problems.tiger()
    rate = -math.log(model.discount)
    mean = (1 / 0.8 - 1) / rate
    solution = mdm.solve(model, durations=Durations(mean), gap=1e-3)
    same = mdm.solve(model.with_discount(0.8), gap=1e-3)
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
        mdm.solve(mdm.problems.dec_tiger(discount=0.9), "jesp", horizon=2, durations=Durations(1.0))
