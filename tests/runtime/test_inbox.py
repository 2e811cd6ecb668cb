"""The inbox, against what a reader who was never late would know."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given, strategies as st

from mdm.runtime.inbox import Inbox


class Lane:
    """As much of a channel as the inbox sees."""

    def __init__(self, supersedes):
        self.supersedes = supersedes


VALUES = Lane(lambda message: message[0] if len(message) == 2 else None)
OTHERS = Lane(None)

MESSAGES = st.lists(st.tuples(st.sampled_from("ABC"), st.booleans()) | st.tuples(st.sampled_from("xy")))


def taken(inbox):
    while (item := inbox.take()) is not None:
        yield item[1]


def seen(messages):
    """Return each event with the values that hold when it comes, and the values at the end."""
    values, events = {}, []
    for message in messages:
        if len(message) == 2:
            values[message[0]] = message[1]
        else:
            events.append((message[0], dict(values)))
    return events, values


@given(MESSAGES)
def test_a_late_reader_misses_values_that_changed_between_events_and_nothing_else(messages):
    inbox = Inbox()
    for message in messages:
        inbox.put(VALUES, message)
    late = list(taken(inbox))
    assert seen(late) == seen(messages)
    assert len(late) + inbox.replaced == len(messages)
    for before, after in pairwise(late):
        assert before[0] != after[0] or len(before) == len(after) == 1


@given(MESSAGES, st.integers(1, 5))
def test_what_is_too_much_is_lost_but_the_latest_values_are_not(messages, bound):
    inbox = Inbox(bound)
    for message in messages:
        inbox.put(VALUES, message)
        assert len(inbox) <= bound + 3  # one more for each of the three
    late = list(taken(inbox))
    (events, values), (all_events, all_values) = seen(late), seen(messages)
    assert values == all_values
    assert [name for name, _ in events] == [name for name, _ in all_events][: len(events)]
    assert inbox.lost == len(all_events) - len(events)
    assert inbox.losses() == ({VALUES: inbox.lost} if inbox.lost else {})
    assert not inbox.losses()


def test_one_channel_does_not_take_the_place_of_another():
    inbox = Inbox(2)
    for number in range(10):
        inbox.put(OTHERS, number)
    inbox.put(VALUES, ("x",))
    assert list(taken(inbox)) == [0, 1, ("x",)]
    inbox.put(OTHERS, 10)
    assert list(taken(inbox)) == [10]
