from __future__ import annotations

import inspect
import re

import pytest
from sentences import refused
from team.copies import Violation
from team.invariants import INVARIANTS, check
from team.lockstep import Lockstep

from mdm.team.agreement.messages import START, Joined, Position, Term
from mdm.team.agreement.state import Ballot, State

FIRST, SECOND = Term(1, "a", 1), Term(2, "b", 1)


def ballot(**joined):
    made = Ballot(dict.fromkeys("abc", 1))
    made.joined = joined
    return made


def joined(*lineage, side=2, digest="1", sound=True):
    return Joined(Term(9, "a", 1), (START, *lineage), side, digest, sound)


def test_a_term_waits_for_all_who_were_called_while_there_is_patience():
    here = joined(Position(FIRST, 3))
    some = ballot(a=here, b=here)
    assert not some.enough(2)
    some.patient = False
    assert some.enough(2)
    assert not some.enough(3)
    assert ballot(a=here, b=here, c=here).enough(2)


@pytest.mark.parametrize(("first", "second", "enough"), [(0, 0, True), (3, 0, False), (3, 3, True)])
def test_who_lost_its_memory_does_not_vouch_for_who_is_silent(first, second, enough):
    some = ballot(a=joined(Position(FIRST, first)) if first else joined(), b=joined(Position(FIRST, 3)))
    if not second:
        some.joined["b"] = joined()
    some.patient = False
    assert some.enough(2) == enough


def test_the_latest_history_is_gone_on_from():
    assert ballot(a=joined(Position(FIRST, 3)), b=joined(Position(FIRST, 4))).source("a", by_side=False) == "b"
    later = joined(Position(FIRST, 3), Position(SECOND, 4))
    assert ballot(a=joined(Position(FIRST, 9)), b=later).source("a", by_side=False) == "b"


def test_of_histories_that_parted_the_larger_side_s_counts():
    alone = joined(Position(FIRST, 3), Position(SECOND, 30), side=1)
    both = joined(Position(FIRST, 9), side=2)
    assert ballot(a=alone, b=both).source("a", by_side=True) == "b"
    before = joined(Position(FIRST, 3), side=2)
    assert ballot(a=before, b=alone).source("a", by_side=True) == "b"


def test_among_equals_most_copies_count_and_then_the_leader_s():
    here = Position(FIRST, 3)
    assert ballot(a=joined(here), b=joined(here)).source("a", by_side=False) == "a"
    assert ballot(a=joined(here), b=joined(here, digest="2")).source("a", by_side=False) == "a"
    other = {"b": joined(here, digest="2"), "c": joined(here, digest="2")}
    assert ballot(a=joined(here), **other).source("a", by_side=False) == "b"


def test_a_leader_that_doubts_its_copy_takes_another():
    here = Position(FIRST, 3)
    doubtful = joined(Position(FIRST, 4), sound=False)
    assert ballot(a=doubtful, b=joined(here)).source("a", by_side=False) == "b"
    assert ballot(a=doubtful).source("a", by_side=False) == "a"


def spoilt(name, **fields):
    """An agent of a team in which another leads, or this one, some fields of whose state are others."""
    agent = Lockstep(3)[name]
    for field, value in fields.items():
        setattr(agent.state, field, value)
    return agent


SPOILT = {
    1: ("b", {"ballot": Ballot({})}),
    2: ("a", {"live": {"a": 1}}),
    3: ("b", {"live": {"b": 2, "c": 3}}),
    4: ("b", {"sound": False}),
    5: ("a", {"fetching": "b", "timers": {"retry": 1}}),
    6: ("b", {"fetching": "a", "timers": {}}),
    7: ("b", {"timers": {"close": 1}}),
    8: ("a", {"applied": {"a": 0, "b": 1}}),
    9: ("b", {"highest": 0}),
}


def test_what_is_said_of_a_state_is_what_is_checked():
    numbers = [int(number) for number in re.findall(r"^([0-9]+)\. ", inspect.getdoc(State), re.MULTILINE)]
    assert numbers == list(INVARIANTS) == list(SPOILT)


@pytest.mark.parametrize("number", SPOILT)
def test_a_state_that_breaks_an_invariant_is_found(number):
    name, fields = SPOILT[number]
    check(spoilt(name))
    with refused(Violation):
        check(spoilt(name, **fields))
