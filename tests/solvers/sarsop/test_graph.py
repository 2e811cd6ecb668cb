"""The graph's table of codes, and the memory that it asks for."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from mdm.models.dynamics import Dynamics
from mdm.problems import tiger
from mdm.solvers.sarsop.graph import bytes_of, grown, hashed, layout_of, new_graph


@given(st.lists(st.integers(0, 2**42 - 1), max_size=60))
def test_a_table_has_each_code_within_a_row_of_full_slots(codes):
    codes = np.array(codes, dtype=np.int64)
    table = hashed(codes, 2 * len(codes))
    for node, code in enumerate(codes):
        slot = code & (len(table) - 1)
        while table[slot] != node:
            assert table[slot] >= 0
            slot = (slot + 1) & (len(table) - 1)


def test_the_bytes_are_those_of_the_arrays_that_are_made():
    model = tiger()
    layout, _ = layout_of(model, Dynamics(model))
    graph = new_graph(layout, 50)
    lengths = {"block": 5_000, "place": 70_000, "values": 1_234, "table": 1 << 14}
    longer = grown(graph, lengths)
    made = [getattr(longer, name).nbytes for name in (*lengths, "informed")]
    assert bytes_of(graph, lengths) == sum(made)
