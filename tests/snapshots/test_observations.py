"""Names and counts of observations."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, strategies as st

from mdm.models import Factor, Space
from mdm.snapshots.observations import most_frequent, observed


@given(st.lists(st.sampled_from("abcdefghijklmnop")))
def test_the_most_frequent_come_first(names):
    counts = Counter(names)
    found = most_frequent(counts)
    assert [count for _, count in found] == sorted(counts.values(), reverse=True)[:8]
    assert dict(found).items() <= counts.items()


def test_an_observation_is_named_by_its_index_or_its_components():
    space = Space([Factor("left", ["wall", "free"]), Factor("right", ["wall", "free"])])
    assert observed(space, (1, None)) == "left free, right ?"
    assert observed(space, 1) == space.names[1]
    assert observed(space, None) is None
    assert observed(None, 3) is None
