"""Rows: what followed, on what the model holds possible."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import visits
from scipy.sparse import csr_array

from mdm.estimation import chains_of, counted, transition_rows
from mdm.estimation.rows import row_of, support, without_staying
from mdm.models import MDP

T = np.array([[[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]]])


def model(**options):
    return MDP(T, np.zeros((3, 1)), discount=0.9, **options)


def rows(states, kind, **options):
    chains = chains_of(visits(states), kind=kind)
    return transition_rows(model(**options), counted(chains.stays()), kind)


@pytest.mark.parametrize("sparse", [False, True])
def test_steps_are_counted_on_the_model_s_support(sparse):
    first, second, third = rows([0, 0, 0, 1, 1, 2, 0, 1], "steps", sparse=sparse)
    assert (first.action, first.state, first.symbols.tolist(), first.counts.tolist()) == (0, 0, [0, 1], [2, 2])
    assert (second.symbols.tolist(), second.counts.tolist()) == ([1, 2], [1, 1])
    assert (third.symbols.tolist(), third.counts.tolist(), third.low.tolist()) == ([0], [1], [1.0])
    assert first.estimates.tolist() == [0.5, 0.5]


def test_jumps_are_counted_without_staying():
    first, second, third = rows([0, 0, 0, 1, 1, 2, 0, 1], "jumps")
    assert [row.symbols.tolist() for row in (first, second, third)] == [[1], [2], [0]]
    assert [row.model.tolist() for row in (first, second, third)] == [[1.0]] * 3
    assert first.counts.tolist() == [2]


def test_what_the_model_holds_impossible_is_told_and_not_averaged_in():
    first, _ = rows([0, 2, 0, 1, 0], "steps")[:2]
    assert (first.impossible, first.counts.tolist(), first.visits) == (((2, 1),), [0, 1], 1)
    possible = rows([0, 1], "steps")[0]
    assert first.estimates.tolist() == possible.estimates.tolist()


def test_the_support_of_a_row_is_the_same_dense_and_compressed():
    for row in range(3):
        dense, sparse = support(T[0], row), support(csr_array(T[0]), row)
        assert dense[0].tolist() == sparse[0].tolist()
        assert dense[1].tolist() == sparse[1].tolist()


def test_a_state_that_is_never_left_has_no_jumps():
    symbols, probability = without_staying(1, np.array([1]), np.array([1.0]))
    row = row_of(0, 1, symbols, probability, {2: 3})
    assert (len(row.symbols), row.visits, row.impossible) == (0, 0, ((2, 3),))
