"""Decision diagrams, against the tables themselves and against the sub-functions that Bryant counts."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from mdm.snapshots.diagram import Diagram

TABLES = arrays(np.int64, array_shapes(min_dims=1, max_dims=4, min_side=1, max_side=3), elements=st.integers(0, 3))


@given(TABLES)
def test_on_every_state_it_decides_as_the_table(table):
    diagram = Diagram.of(table, 4)
    for values in itertools.product(*map(range, table.shape)):
        way = diagram.path(values)
        assert way[-1] == table[values]
        asked = [diagram.place(node) for node in way]
        assert asked == sorted(set(asked))  # each factor once at most, in the order


@given(TABLES)
def test_it_has_a_node_for_each_sub_function_that_depends_on_its_factor_and_no_other(table):
    diagram = Diagram.of(table, 4)
    ordered = table.transpose(diagram.order)
    for place, rows in enumerate(diagram.levels):
        found = set()
        for values in itertools.product(*map(range, ordered.shape[:place])):
            below = ordered[values]
            if len({below[value].tobytes() for value in range(len(below))}) > 1:
                found.add(below.tobytes())
        assert len(rows) == len(found)


@given(TABLES)
def test_its_order_is_nearly_the_best_one(table):
    def size(order):
        ordered = table.transpose(order)
        return sum(
            len(
                {
                    ordered[values].tobytes()
                    for values in itertools.product(*map(range, ordered.shape[:place]))
                    if (ordered[values] != ordered[values][:1]).any()
                }
            )
            for place in range(table.ndim)
        )

    least = min(map(size, itertools.permutations(range(table.ndim))))
    assert least <= sum(map(len, Diagram.of(table, 4).levels)) <= 1.5 * least + 1


def test_a_factor_that_decides_nothing_is_not_asked():
    table = np.zeros((10,) * 5, np.int64)
    table[:, 3] = 1
    table[2, 3, :, 4] = 2
    diagram = Diagram.of(table, 3)
    assert {diagram.order[at] for at, rows in enumerate(diagram.levels) if len(rows)} == {0, 1, 3}
    assert sum(map(len, diagram.levels)) == 3


def test_a_large_table_is_cut_by_how_many_entries_each_factor_changes(monkeypatch):
    table = np.indices((4, 5, 6)).sum(axis=0) % 3
    monkeypatch.setattr("mdm.snapshots.diagram._WORK", 0)
    diagram = Diagram.of(table, 3)
    for values in itertools.product(*map(range, table.shape)):
        assert diagram.path(values)[-1] == table[values]
