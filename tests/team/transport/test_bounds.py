from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, strategies as st

from mdm.team.transport.bounds import HOUR, Life, Name, Number, Text, can_be


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


@given(st.integers(0, 2**62), st.integers(1, 10**9))
def test_what_is_counted_on_from_the_line_is_behind_it_when_the_next_can_have_been(now, each):
    most = (now + HOUR) // each
    assert can_be(most, now, each)
    assert not can_be(most + 1, now, each)
    assert can_be(most + 1, now + each, each)
