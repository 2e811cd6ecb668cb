from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, strategies as st

from mdm.controller.held import Held, opened
from mdm.errors import Error
from mdm.messages import Belief
from mdm.team import communicating
from mdm.team.agreement import messages
from mdm.team.centralised import messages as centralised
from mdm.team.sharing.remote import Wire
from mdm.team.transport.bounds import HOUR, UNREADABLE, Life, Name, Number, Text, can_be


def _said_of(number):
    episode = communicating.Episode(number, 0, "a", running=True)
    return communicating.encode(communicating.Update(episode, ""))


def _opened_by(decode):
    def opening(body):
        try:
            return decode(body)
        except UNREADABLE as error:
            raise Error(str(error)) from None

    return opening


@pytest.mark.parametrize(
    ("kind", "taken", "refused"),
    [
        (Number, [0, 2**62 - 1], [-1, 2**62, 2**64 - 1, 1.5, None]),
        (Life, [0, 2**63 - 1], [-1, 2**63, 2**64 - 1]),
        (Name, ["", "a" * 256], ["a" * 257, 1, b"a"]),
        (Text, ["", "a" * 4096], ["a" * 4097]),
    ],
)
def test_what_is_none_is_refused_where_it_is_decoded(kind, taken, refused):
    decode = msgspec.msgpack.Decoder(kind).decode
    for value in taken:
        assert decode(msgspec.msgpack.encode(value)) == value
    for value in refused:
        with pytest.raises(msgspec.ValidationError):
            decode(msgspec.msgpack.encode(value))


DEEP = b"\x91" * 100_000 + b"\xc0"
"""Arrays within arrays, deeper than calls go in any Python."""


@pytest.mark.parametrize(
    ("decode", "whole"),
    [
        (messages.decode, messages.encode(messages.Stale(messages.START.term))),
        (_opened_by(centralised.decode_proposal), centralised.encode(centralised.Proposal(0, 0, None, None))),
        (
            _opened_by(communicating.decode),
            _said_of(0),
        ),
        (opened, msgspec.msgpack.encode(Held("", 0, None, False, None, None, None))),
        (Wire(Belief).decode, msgspec.msgpack.encode({"time": 0, "probabilities": None})),
    ],
)
def test_values_too_deep_within_each_other_are_refused_as_all_else_is(decode, whole):
    head = whole[0] + 1  # an array of one more value, or a mapping
    for body in (DEEP, bytes([head]) + whole[1:] + DEEP, bytes([head]) + whole[1:] + b"\xa1x" + DEEP):
        with pytest.raises(Error):
            decode(body)


@given(st.integers(0, 2**62), st.integers(1, 10**9))
def test_what_is_counted_on_from_the_line_is_behind_it_when_the_next_can_have_been(now, each):
    most = (now + HOUR) // each
    assert can_be(most, now, each)
    assert not can_be(most + 1, now, each)
    assert can_be(most + 1, now + each, each)
