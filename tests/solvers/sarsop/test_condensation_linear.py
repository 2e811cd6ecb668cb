"""Linear systems of values, against a direct solution; and what is left of them when time is up."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from mdm.solvers.sarsop.condensation import solved


def contraction(seed, size=12, discount=0.95):
    random = np.random.default_rng(seed)
    matrix = random.random((size, size)) * (random.random((size, size)) < 0.3)
    matrix /= np.maximum(matrix.sum(axis=1, keepdims=True), 1e-3)
    return discount * matrix, random.normal(size=size), random.normal(size=size)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 12]))
def test_a_system_is_solved(seed, size):
    matrix, earned, begin = contraction(seed, size)
    found = solved(lambda values: matrix @ values, earned, begin, 1e-9)
    assert np.abs(found - np.linalg.solve(np.eye(size) - matrix, earned)).max() <= 1e-9 / (1 - 0.95)


@pytest.mark.parametrize("most", [1, 2, 5, 10, 17])
def test_the_nearest_values_are_left_when_time_is_up(most):
    matrix, earned, begin = contraction(7, 60, 0.999)
    tried = []

    def ahead(values):
        if len(tried) == most:
            raise TimeoutError
        tried.append(values)
        return matrix @ values

    found = solved(ahead, earned, begin, 0.0)
    residual = np.abs(earned + matrix @ found - found).max()
    assert residual <= np.abs(earned + matrix @ begin - begin).max()
    if most >= 10:  # what a step of value iteration alone would not do
        assert residual < 0.5 * np.abs(earned + matrix @ begin - begin).max()


def test_a_cycle_in_which_the_method_breaks_down_is_solved():
    matrix = 0.9 * np.roll(np.eye(4), 1, axis=1)
    for unit in itertools.chain(np.eye(4), -np.eye(4)):
        found = solved(lambda values: matrix @ values, unit, np.zeros(4), 1e-10)
        assert found == pytest.approx(np.linalg.solve(np.eye(4) - matrix, unit), abs=1e-8)
