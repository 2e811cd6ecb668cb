"""Statements of probabilities, against plain arrays that are filled one after another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import sparse
from sentences import refused

from mdm import ModelError
from mdm.formats.cassandra.parameters import Probabilities

NUMBERS = st.sampled_from([0.0, 0.0, 0.25, 0.5, 1.0])


@st.composite
def statements(draw, actions, rows, columns):
    """Return a statement's arguments, and what it does to an A x rows x columns array."""
    action = draw(st.none() | st.integers(0, actions - 1) | st.lists(st.integers(0, actions - 1), min_size=1))
    chosen = slice(None) if action is None else action
    form = draw(st.sampled_from(["entry", "entries", "row", "rows", "matrix", "identity", "all", "column"]))
    row, column = draw(st.integers(0, rows - 1)), draw(st.integers(0, columns - 1))

    def drawn(*shape):
        return np.array(draw(st.lists(NUMBERS, min_size=int(np.prod(shape)), max_size=int(np.prod(shape))))).reshape(
            shape
        )

    def fill(array, where, value):
        for each in np.atleast_1d(np.arange(actions)[chosen]):
            array[each][where] = value

    if form == "entry":
        value = draw(NUMBERS)
        return (action, row, column, value), lambda array: fill(array, (row, column), value)
    if form == "entries":
        count = draw(st.integers(1, 6))
        at, to = (
            np.array(draw(st.lists(st.integers(0, size - 1), min_size=count, max_size=count)))
            for size in (rows, columns)
        )
        values = drawn(count)

        def one_by_one(array):
            for place in zip(at, to, values, strict=True):
                fill(array, place[:2], place[2])

        return (action, at, to, values), one_by_one
    if form == "row":
        values = drawn(columns)
        return (action, row, None, values), lambda array: fill(array, row, values)
    if form == "rows":
        values = drawn(columns)
        return (action, None, None, values), lambda array: fill(array, slice(None), values)
    if form == "matrix":
        values = drawn(rows, columns)
        return (action, None, None, values), lambda array: fill(array, slice(None), values)
    if form == "identity":
        values = np.eye(rows, columns)
        return (action, None, None, sparse.csr_array(values)), lambda array: fill(array, slice(None), values)
    value = draw(NUMBERS)
    if form == "all":
        return (action, None, None, value), lambda array: fill(array, slice(None), value)
    return (action, None, column, value), lambda array: fill(array, (slice(None), column), value)


@given(st.integers(1, 3), st.integers(1, 4), st.integers(1, 4), st.data())
def test_the_last_statement_that_covers_an_entry_counts(actions, rows, columns, data):
    collected, array = Probabilities(actions, rows, columns), np.zeros((actions, rows, columns))
    told = set()
    for _ in range(data.draw(st.integers(1, 6))):
        arguments, do = data.draw(statements(actions, rows, columns))
        collected.add(*arguments)
        do(array)
        told |= set(np.atleast_1d(np.arange(actions)[slice(None) if arguments[0] is None else arguments[0]]).tolist())
    assert collected.missing() == sorted(set(range(actions)) - told)
    for expected, matrix in zip(array, collected.matrices(), strict=True):
        np.testing.assert_array_equal(matrix.toarray(), expected)
        assert matrix.has_canonical_format
        assert matrix.data.all()


def test_actions_of_the_same_statements_share_a_matrix():
    collected = Probabilities(3, 2, 2)
    collected.add(None, None, None, np.eye(2))
    collected.add(1, 0, 1, 0.5)
    first, second, third = collected.matrices()
    assert first is third
    assert first is not second


@pytest.mark.parametrize("arguments", [(None, None, 0.5), (None, None, np.full(100_000, 0.5))])
def test_more_numbers_than_can_be_held_are_refused(arguments):
    collected = Probabilities(1, 100_000, 100_000)
    collected.add(0, *arguments)
    with refused(ModelError):
        collected.matrices()
