"""Information states: the observed state, what is drawn along with others, and snapshots of one's own."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sentences import refused

from mdm import ModelError
from mdm.beliefs.information import DrawnInformation, KnownState, restore, snapshot


def test_a_known_state_is_the_last_one_observed():
    known = KnownState()
    assert known.current is None
    assert known.update(None, 2) == 1
    assert known.update(0, None) == 1
    assert known.current == 2
    assert known.expected(np.array([5.0, 6.0, 7.0])) == 7
    known.reset()
    assert known.current is None
    with refused(ModelError):
        known.reset([0.5, 0.5])


def drawn(information, steps):
    """Return the numbers of some steps."""
    numbers = []
    for step in range(steps):
        numbers.append(information.current.number)
        assert information.current.number == numbers[-1]  # one number until the next update
        information.update(0, step)
    return numbers


def test_numbers_come_with_a_seed_and_go_on_over_episodes():
    first, again, other = (DrawnInformation(KnownState(), seed) for seed in (1, 1, 2))
    numbers = drawn(first, 5)
    first.reset()
    numbers += drawn(first, 5)
    assert len(set(numbers)) == 10
    assert all(0 <= number < 1 for number in numbers)
    assert drawn(again, 10) == numbers
    assert drawn(other, 10) != numbers


@pytest.mark.parametrize("read", [True, False])
def test_a_snapshot_goes_on_with_the_same_numbers(read):
    one, other = DrawnInformation(KnownState(), 3), DrawnInformation(KnownState(), 4)
    drawn(one, 3)
    if read:
        assert one.current.by == 2
    restore(other, json.loads(json.dumps(snapshot(one))))  # it is made of numbers and strings
    assert other.current == one.current
    assert drawn(other, 4) == drawn(one, 4)


class Halving:
    """A tracker that has no snapshots of its own."""

    current = np.array([1.0, 0.0])

    def reset(self, belief=None):
        self.current = np.full(2, 0.5) if belief is None else belief


def test_without_its_own_a_snapshot_is_what_it_shows():
    one, other = Halving(), Halving()
    one.reset()
    taken = snapshot(one)
    assert taken == [0.5, 0.5]
    restore(other, taken)
    np.testing.assert_array_equal(other.current, [0.5, 0.5])
