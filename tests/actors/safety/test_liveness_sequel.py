"""What an action's end is followed by, as plain data."""

from __future__ import annotations

import itertools

import pytest

from mdm import ConfigError
from mdm.actors.options import Sequel
from mdm.actors.safety.liveness import LONGEST_PAUSE, Due, Tries


def test_by_default_nothing_follows():
    tries = Tries()
    for failed in (False, True, True):
        assert tries.ended("Go", Sequel(), failed=failed) == Due()


def test_pauses_double_up_to_a_minute_and_begin_anew_after_a_success():
    tries, sequel = Tries(), Sequel("decide", pause=0.5)
    pauses = [tries.ended("Go", sequel, failed=True).pause for _ in range(10)]
    assert pauses == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0, 60.0]
    assert tries.ended("Go", sequel, failed=False).pause == 0.5
    assert tries.ended("Go", sequel, failed=True).pause == 0.5


def test_a_pause_longer_than_the_longest_stays_as_it_is():
    tries, sequel = Tries(), Sequel("decide", pause=300.0)
    assert LONGEST_PAUSE < 300
    assert [tries.ended("Go", sequel, failed=True).pause for _ in range(3)] == [300.0] * 3


def test_failures_without_end_overflow_nothing():
    tries, sequel = Tries(), Sequel("decide")
    for _ in range(5000):
        due = tries.ended("Go", sequel, failed=True)
    assert due.pause == LONGEST_PAUSE


def test_failures_count_by_action():
    tries, sequel = Tries(), Sequel("decide", attempts=2)
    ends = [tries.ended(name, sequel, failed=True) for name in "ABAB"]
    assert ends == [Due(1.0)] * 4
    assert tries.ended("B", sequel, failed=True) == Due(gave_up=True)


def test_the_beginning_of_another_action_ends_a_row():
    tries, sequel = Tries(), Sequel("decide")
    assert not tries.counting
    assert [tries.ended("Go", sequel, failed=True).pause for _ in range(2)] == [1.0, 2.0]
    tries.began("Go")
    assert tries.counting
    tries.began("Look")
    assert not tries.counting
    assert tries.ended("Go", sequel, failed=True).pause == 1.0


@pytest.mark.parametrize(("options", "counting"), [({}, False), ({"attempts": 2}, True), ({"then": "decide"}, True)])
def test_a_row_counts_where_something_follows_from_it(options, counting):
    tries = Tries()
    tries.ended("Go", Sequel(**options), failed=True)
    assert tries.counting == counting


def test_failures_are_decided_again_where_the_ensemble_says_so():
    tries = Tries()
    assert tries.ended("Go", Sequel("wait"), failed=True, retries=True) == Due(1.0)
    assert tries.ended("Go", Sequel("wait"), failed=False, retries=True) == Due()


def test_giving_up_comes_after_exactly_so_many_failures_in_a_row():
    """Against a count of our own, over every sequence of eight ends."""
    for attempts, ends in itertools.product((1, 2, 3), itertools.product((True, False), repeat=8)):
        tries, sequel, row = Tries(), Sequel("decide", attempts=attempts), 0
        for failed in ends:
            row = row + 1 if failed else 0
            due = tries.ended("Go", sequel, failed=failed)
            assert due.gave_up == (row == attempts)
            assert (due.pause is None) == due.gave_up
            if due.gave_up:
                row = 0


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"then": "again"}, "then"),
        ({"pause": 0}, "pause"),
        ({"pause": float("nan")}, "pause"),
        ({"attempts": 0}, "attempts"),
        ({"attempts": True}, "attempts"),
        ({"attempts": 1.5}, "attempts"),
    ],
)
def test_wrong_options(options, key):
    with pytest.raises(ConfigError) as caught:
        Sequel(**options)
    assert caught.value.key == key
