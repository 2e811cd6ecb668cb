"""Names and counts of observations."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, strategies as st

from mdm.models import Factor, Space
from mdm.snapshots.observations import at_state, most_frequent, observed, on_observing


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


def test_a_decision_is_in_a_state_or_on_an_observation():
    space = Space([Factor("person", ["yes", "no"]), Factor("fire", ["yes", "no"])])
    assert at_state(space, 1) == "in state person yes, fire no"
    assert at_state(Space.single("state", ["hall", "lab"]), 1) == "in state lab"
    assert at_state(None, 7) == "in state 7"
    assert on_observing("hear-left") == "on observing hear-left"
    assert on_observing(None) == ""
