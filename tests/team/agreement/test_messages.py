from __future__ import annotations

import pytest
from sentences import refused

from mdm.errors import Error
from mdm.team.agreement import decode, encode
from mdm.team.agreement.messages import (
    START,
    Applied,
    Begin,
    Call,
    Command,
    Commit,
    Component,
    Ended,
    Entries,
    Fetch,
    Joined,
    Position,
    Snapshot,
    Stale,
    Term,
    is_possible,
)

AGENTS = ("a", "b", "c")
TERM = Term(3, "a", 17)
COMMIT = Commit(TERM, 5, TERM, {"a": b"left", "b": b""}, ("c",), None, "", "4711")

MESSAGES = [
    Call(TERM, {"a": 17, "b": 4}),
    Joined(TERM, (START, Position(TERM, 4)), 2, "4711", True),
    Stale(TERM),
    Ended(TERM),
    Begin(TERM, START, "0", ("a", "b")),
    Component(TERM, 5, None),
    Component(TERM, 5, b"left"),
    Command(TERM, 5, "stop"),
    COMMIT,
    Applied(TERM, 4),
    Fetch(TERM, START, None),
    Entries(TERM, (COMMIT, COMMIT)),
    Snapshot(TERM, (START,), 2, "4711", bytes(range(256))),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_a_message_is_the_same_after_its_way(message):
    assert decode(encode(message)) == message


@pytest.mark.parametrize("body", [b"", b"\xc1", encode(MESSAGES[0])[:-1], b"\x92\xa4what\x01", b"\x92\xa5stale\x01"])
def test_anything_else_is_refused(body):
    with refused(Error):
        decode(body)


def test_terms_are_ordered_by_number_leader_and_life():
    terms = [Term(1, "b", 9), Term(2, "a", 9), Term(2, "b", 1), Term(2, "b", 2)]
    assert sorted(terms) == terms
    assert START.term < terms[0]


@pytest.mark.parametrize(
    "body",
    [
        encode(Stale(Term(2**64 - 1, "a", 1))),
        encode(Stale(Term(2**62, "a", 1))),
        encode(Stale(Term(-1, "a", 1))),
        encode(Stale(Term(1, "a", -1))),
        encode(Stale(Term(1, "a" * 257, 1))),
        encode(Applied(TERM, -1)),
        encode(Applied(TERM, 2**63)),
        encode(Begin(TERM, START, "0", ("a",) * 257)),
        encode(Joined(TERM, (START,) * 65, 2, "4711", True)),
    ],
)
def test_numbers_and_sizes_that_nobody_says_are_refused(body):
    with refused(Error):
        decode(body)


def test_terms_are_believed_that_there_was_time_for():
    hour = 3_600_000
    assert is_possible(Stale(Term(hour, "b", 2)), AGENTS, 0)
    assert not is_possible(Stale(Term(hour + 1, "b", 2)), AGENTS, 0)
    assert is_possible(Stale(Term(hour + 1, "b", 2)), AGENTS, 1_000_000)
    assert not is_possible(Stale(Term(1, "nobody", 2)), AGENTS, 0)
    assert is_possible(Stale(START.term), AGENTS, 0)


def test_steps_are_believed_that_there_was_time_for_and_no_later_term_than_the_message_s():
    term, most = Term(3, "b", 2), 3_600_000_000
    for step, early in ((most, True), (most + 1, False), (2**62 - 1, False)):
        at = Position(term, step)
        for message in (
            Applied(term, step),
            Component(term, step, None),
            Begin(term, at, "", ()),
            Fetch(term, at, None),
            Joined(term, (START, at), 1, "", sound=True),
            Snapshot(term, (START, at), 1, "", b""),
            Entries(term, (Commit(term, step, term, {}, (), None, "", ""),)),
        ):
            assert is_possible(message, AGENTS, 0) == early
    assert not is_possible(Begin(term, Position(Term(4, "b", 2), 1), "", ()), AGENTS, 0)
    assert not is_possible(Joined(term, (Position(Term(4, "b", 2), 1),), 1, "", sound=True), AGENTS, 0)
