"""Memories of what recurs."""

from __future__ import annotations

from hypothesis import given, strategies as st

from mdm.logic import network as memory
from mdm.logic.network import Memory


def test_what_was_kept_is_found():
    known = Memory()
    assert known.keep("a", 1) == 1
    assert known.get("a") == 1
    assert known.get("b") is None


@given(keys=st.lists(st.integers(0, 30), max_size=100), most=st.integers(1, 10))
def test_a_memory_never_holds_more_than_its_bound(keys, most):
    known, bound = Memory(), memory.MOST
    memory.MOST = most
    try:
        for key in keys:
            if known.get(key) is None:
                known.keep(key, -key)
            assert known[key] == -key
            assert len(known) <= most
    finally:
        memory.MOST = bound
