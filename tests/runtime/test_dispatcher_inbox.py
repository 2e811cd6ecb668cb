"""The inbox, against what a reader who was never late would know."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given, strategies as st

from mdm.runtime.dispatcher import Inbox


class Lane:
    """As much of a channel as the inbox sees."""

    def __init__(self, supersedes, merge=lambda older, newer: newer):
        self.supersedes = supersedes
        self.merge = merge


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


BATCHES = Lane(
    lambda message: tuple(message) if isinstance(message, dict) else None, lambda older, newer: {**older, **newer}
)


@given(
    st.lists(st.dictionaries(st.sampled_from("ABC"), st.booleans(), min_size=1) | st.sampled_from(["x", "y", "take"])),
    st.integers(1, 5),
)
def test_what_is_too_much_is_lost_but_the_latest_values_are_not(messages, bound):
    inbox = Inbox(bound)
    late, all_values, events = [], {}, []
    for message in messages:
        if message == "take":
            late += [item[1]] if (item := inbox.take()) is not None else []
            continue
        lost = inbox.lost
        inbox.put(BATCHES, message)
        assert len(inbox) <= bound + 1
        if isinstance(message, dict):
            all_values |= message
        elif inbox.lost == lost:
            events.append(message)
    late += taken(inbox)
    values = {}
    for message in late:
        values |= message if isinstance(message, dict) else {}
    assert values == all_values
    assert [message for message in late if isinstance(message, str)] == events
    assert inbox.losses() == ({BATCHES: inbox.lost} if inbox.lost else {})
    assert not inbox.losses()


def test_batches_of_ever_other_predicates_flood_nothing():
    inbox = Inbox(8)
    for number in range(1000):
        inbox.put(BATCHES, {index: number for index in range(10) if number >> index & 1} or {"none": number})
    assert len(inbox) == 9
    values = {}
    for message in taken(inbox):
        values |= message
    assert values == {"none": 0, **{index: max(n for n in range(1000) if n >> index & 1) for index in range(10)}}


def test_one_channel_does_not_take_the_place_of_another():
    inbox = Inbox(2)
    for number in range(10):
        inbox.put(OTHERS, number)
    inbox.put(VALUES, ("x",))
    assert list(taken(inbox)) == [0, 1, ("x",)]
    inbox.put(OTHERS, 10)
    assert list(taken(inbox)) == [10]
