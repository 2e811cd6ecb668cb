"""Distributions as they are written."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from mdm.formats.writers import closed, initial
from mdm.models import Node, Space, Table, TwoSliceNetwork


def test_rows_that_miss_a_sum_of_one_are_divided_and_others_stay():
    rows = np.array([[0.1, 0.2, 0.7], [0.1, 0.2, 0.7 + 1e-10], [1 / 3, 1 / 3, 1 / 3]])
    written = closed(rows)
    assert abs(written.sum(axis=1) - 1).max() < 1e-15
    np.testing.assert_array_equal(written[[0, 2]], rows[[0, 2]])
    np.testing.assert_array_equal(closed(sparse.csr_array(rows)).toarray(), written)


def test_initial_distributions_of_a_factor_are_closed():
    lamp = Node("state", 0)
    network = TwoSliceNetwork(
        Space.single("lamp", 2),
        Space.single("hand", 1),
        initial=[Table([lamp], [0.3, 0.7 + 1e-7])],
        transitions=[Table([lamp, Node("next_state", 0)], np.eye(2))],
    )
    (table,) = initial(network)
    assert abs(table.values.sum() - 1) < 1e-15
