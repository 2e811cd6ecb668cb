from __future__ import annotations

import pytest

from mdm.errors import Error
from mdm.team.agreement import decode, encode
from mdm.team.agreement.entries import (
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
)

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
    with pytest.raises(Error, match="this is no message of an agreement"):
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
    with pytest.raises(Error, match="this is no message of an agreement"):
        decode(body)
