"""Texts of exceptions: whatever they hold, each record, page and terminal takes them."""

from __future__ import annotations

import msgspec
import pytest

from mdm import Ensemble
from mdm.messages import Cause, Fault
from mdm.models import MDP
from mdm.runtime.supervision import describe
from mdm.texts import counted, encodable


class Own(str):
    __slots__ = ()

    def __getitem__(self, place):
        raise ValueError("no place has a letter")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no goal in café, 目標", "no goal in café, 目標"),
        ("caf\udce9.yaml", "caf\\udce9.yaml"),
        ("two\nlines\tand \0 \x1b[2J", "two\nlines\tand \\x00 \\x1b[2J"),
        ("<b>&amp;</b>", "<b>&amp;</b>"),
        (Own("own"), "own"),
    ],
)
def test_what_cannot_be_encoded_or_shown_is_escaped(text, told):
    found = encodable(text)
    assert (found, type(found)) == (told, str)
    assert encodable(found) == found
    msgspec.json.encode(Fault(0, "robot", "action", text))
    assert describe(ValueError(text)) == f"ValueError: {told}"


@pytest.mark.parametrize("letter", ["x", "\0", "\udce9"], ids=ascii)
def test_a_long_text_is_cut_and_says_how_long_it_was(letter):
    for size in (3_999, 4_000, 4_001, 10_000_000):
        found = encodable(letter * size)
        assert len(found) <= 4_000
        assert encodable(found) == found
        if letter == "x" and size <= 4_000:
            assert found == letter * size
        else:
            assert found.endswith(f"… ({size:,} characters)")


def test_the_detail_of_a_fault_need_be_no_text():
    assert Fault(0, "robot", "own", 3).detail == 3


def test_one_has_no_plural():
    assert [counted(1, "action"), counted(0, "state"), counted(2000, "step", ",")] == [
        "1 action",
        "0 states",
        "2,000 steps",
    ]
    one = MDP([[[1.0]]], [[0.0]], discount=0.9)
    assert repr(one) == "<MDP: 1 state, 1 action>"
    robot = Ensemble("robot", policy=[0], actions={"Go": print})
    assert robot.summary() == "MDP, 1 state, 1 action, event-driven"


def test_a_cause_tells_seconds():
    assert str(Cause("action", "Go has failed", 1_500_000_000)) == "action since 1.5 s: Go has failed"


def test_a_program_of_any_name_is_named_as_it_can_be_encoded():
    found = {}
    exec(compile("def fail():\n    raise ValueError('no goal')", "caf\udce9.py", "exec"), found)
    with pytest.raises(ValueError, match="no goal") as failure:
        found["fail"]()
    assert describe(failure.value) == "ValueError: no goal (at caf\\udce9.py:2)"
