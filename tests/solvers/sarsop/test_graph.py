"""The graph's table of codes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from mdm.solvers.sarsop.graph import hashed


@given(st.lists(st.integers(0, 2**42 - 1), max_size=60))
def test_a_table_has_each_code_within_a_row_of_full_slots(codes):
    codes = np.array(codes, dtype=np.int64)
    table = hashed(codes, 2 * len(codes))
    for node, code in enumerate(codes):
        slot = code & (len(table) - 1)
        while table[slot] != node:
            assert table[slot] >= 0
            slot = (slot + 1) & (len(table) - 1)
