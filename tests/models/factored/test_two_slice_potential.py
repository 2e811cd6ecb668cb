"""Potentials, one number at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import ModelError
from mdm.models import Node, Table, Tree

CHILD = Node("next_state", 0)
PARENTS = [Node("state", 0), Node("state", 1), Node("action", 0)]
SIZES = {CHILD: 3, PARENTS[0]: 2, PARENTS[1]: 3, PARENTS[2]: 1}


def number(potential, digits):
    """Return a potential at one value of every variable, by its definition."""
    while isinstance(potential, Tree):
        potential = potential.branches[potential.choice[digits[potential.node]]]
    return potential.values[tuple(digits[node] for node in potential.scope)]


@st.composite
def potentials(draw, depth=2):
    """Return a table or a tree over any of the variables; the child may be at the top, or not occur at all."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if depth == 0 or draw(st.booleans()):
        scope = draw(st.lists(st.sampled_from([CHILD, *PARENTS]), unique=True))
        return Table(scope, random.normal(size=[SIZES[node] for node in scope]))
    node = draw(st.sampled_from([CHILD, *PARENTS]))
    branches = draw(st.lists(potentials(depth - 1), min_size=1, max_size=3))
    choice = st.integers(0, len(branches) - 1)
    return Tree(node, draw(st.lists(choice, min_size=SIZES[node], max_size=SIZES[node])), branches)


@given(potentials(), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_rows_hold_the_number_at_each_value_of_the_child(potential, count, seed):
    random = np.random.default_rng(seed)
    digits = {node: random.integers(SIZES[node], size=count) for node in PARENTS}
    rows = potential.rows(digits, count, CHILD, SIZES[CHILD])
    assert rows.shape == (count, SIZES[CHILD])
    for at, value in np.ndindex(rows.shape):
        assert rows[at, value] == number(potential, {node: of[at] for node, of in digits.items()} | {CHILD: value})


@given(potentials(), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_rows_without_a_child_are_one_number_each(potential, count, seed):
    random = np.random.default_rng(seed)
    digits = {node: random.integers(size, size=count) for node, size in SIZES.items()}
    rows = potential.rows(digits, count, None, 1)
    assert rows.shape == (count, 1)
    for at in range(count):
        assert rows[at, 0] == number(potential, {node: of[at] for node, of in digits.items()})


@given(potentials())
def test_the_scope_of_a_tree_is_that_of_its_node_and_branches(potential):
    def found(part):
        if isinstance(part, Table):
            return set(part.scope)
        return {part.node}.union(*map(found, part.branches))

    assert set(potential.scope) == found(potential)
    assert len(potential.scope) == len(set(potential.scope))
    assert potential.sizes == {node: SIZES[node] for node in potential.scope}


def test_tables_are_copies_that_cannot_be_changed():
    given_ = np.array([1.0, 2.0])
    table = Table([PARENTS[0]], given_)
    given_[0] = 7
    assert table.values.tolist() == [1, 2]
    with refused(ValueError):
        table.values[0] = 7


@pytest.mark.parametrize(
    ("scope", "values", "message"),
    [
        ([CHILD], [[0.5, 0.5]], "over 1 variables cannot have 2 axes"),
        ([], [1.0], "over 0 variables cannot have 1 axes"),
        ([CHILD, CHILD], np.eye(3), "table over 2 variables"),
        ([CHILD], [[1.0], [1.0, 2.0]], "not an array of numbers"),
        ([CHILD], ["a", "b"], "not an array of numbers"),
    ],
)
def test_tables_that_do_not_fit_their_scope_are_refused(scope, values, message):
    with pytest.raises(ModelError, match=message):
        Table(scope, values)


@pytest.mark.parametrize(
    ("choice", "branches", "message"),
    [
        ([], [Table([], 1.0)], "a branch for every value"),
        ([0, 1], [Table([], 1.0)], "a branch for every value"),
        ([0, -1], [Table([], 1.0)], "a branch for every value"),
        ([0, 0], [Table([PARENTS[0]], [1.0, 2.0, 3.0])], "3 or 2 values"),
        ([0, 1], [Table([CHILD], [1.0, 2.0]), Table([CHILD], [1.0, 2.0, 3.0])], "3 or 2 values"),
    ],
)
def test_trees_that_leave_values_open_or_contradict_themselves_are_refused(choice, branches, message):
    with pytest.raises(ModelError, match=message):
        Tree(PARENTS[0], choice, branches)
