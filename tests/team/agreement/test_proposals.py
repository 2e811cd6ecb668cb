from __future__ import annotations

from mdm.team.agreement.messages import Commit, Term
from mdm.team.agreement.proposals import COMMANDS, WAITING, Asked, Proposals

TERM = Term(1, "a", 1)


def proposals(event_driven, *components, offered=None):
    made = Proposals("a", event_driven=event_driven)
    for component in components:
        made.add(component, None)
    made.offered = None if offered is None else (TERM, offered)
    return made


def commit(step, inputs=(), command=None, by="", token=""):
    return Commit(TERM, step, TERM, dict(inputs), (), command, by, "", token)


def asked(command, token="", term=TERM):
    return Asked(command, token, term)


def waiting(made):
    return [(one.command, one.token) for one in made.commands]


def voided(made):
    return [(one.token, reason) for one, reason in made.void]


def test_the_newest_reading_of_a_fixed_rate_waits():
    made = proposals(False, b"1", b"2")
    assert list(made.components) == [b"2"]
    made.offered = (TERM, 1)
    made.add(b"3", None)
    made.add(None, None)
    assert list(made.components) == [b"2", None]
    assert made.dropped == 2


def test_events_wait_in_their_order_and_nothing_seen_is_none():
    made = proposals(True, b"1", None, b"2")
    assert list(made.components) == [b"1", b"2"]


def test_a_step_takes_what_was_offered_for_it():
    made = proposals(True, b"1", b"2", offered=4)
    made.settle(commit(4, {"a": b"1"}))
    assert (list(made.components), made.offered) == ([b"2"], None)


def test_an_event_that_a_step_went_without_is_kept_and_a_reading_is_not():
    kept, dropped = proposals(True, b"1", offered=4), proposals(False, b"1", offered=4)
    for made in (kept, dropped):
        made.settle(commit(4, {"b": b"2"}))
    assert list(kept.components) == [b"1"]
    assert (list(dropped.components), dropped.dropped) == ([], 1)


def test_both_are_kept_over_a_command():
    for event_driven in (False, True):
        made = proposals(event_driven, b"1", offered=4)
        made.settle(commit(4, command="stop", by="b"))
        assert (list(made.components), made.offered) == ([b"1"], None)


def test_a_command_waits_until_it_is_a_step():
    made = proposals(True)
    made.add(None, asked("stop", "a1"))
    made.commanded = (TERM, 1)
    made.settle(commit(1, command="stop", by="b", token="a1"))  # which was asked for the same
    assert waiting(made) == [("stop", "a1")]
    assert made.commanded is None
    made.settle(commit(2, command="stop", by="a", token="a1"))
    assert not made.commands


def test_what_another_was_asked_for_too_is_a_step_once():
    made = proposals(True)
    made.add(None, asked("start", "x"))
    made.settle(commit(1, command="start", by="b", token="x"))
    assert not made.commands
    assert not made.void


def test_a_stop_beats_what_was_asked_for_before_it():
    here, there = proposals(True), proposals(True)
    for made in (here, there):
        made.add(None, asked("start", "a1"))
        made.commanded = (TERM, 1)
    here.add(None, asked("stop", "a2"))
    there.settle(commit(1, command="stop", by="b", token="b1"))
    assert waiting(here) == [("stop", "a2")]
    assert waiting(there) == []
    assert here.commanded is there.commanded is None
    assert voided(here) == [("a1", "a stop was asked for after it")]
    assert voided(there) == [("a1", "a stop of b came before it")]


def test_what_was_asked_for_after_a_stop_of_ones_own_is_kept():
    made = proposals(True)
    made.add(None, asked("stop", "a1"))
    made.add(None, asked("start", "a2"))
    made.settle(commit(1, command="stop", by="a", token="a1"))
    assert waiting(made) == [("start", "a2")]
    made.settle(commit(2, command="hold", by="b", token="b1"))
    assert voided(made) == [("a2", "a hold of b came before it")]


def test_a_command_is_void_in_a_later_term():
    made = proposals(True)
    made.add(None, asked("start", "a1"))
    made.renew(TERM)
    assert waiting(made) == [("start", "a1")]
    made.renew(Term(2, "b", 1))
    assert waiting(made) == []
    assert voided(made) == [("a1", "the term in which it was asked for has ended")]


def test_a_command_that_an_earlier_life_gave_is_not_this_one():
    made = proposals(True)
    made.add(None, asked("stop", "a.2.1"))
    made.settle(commit(1, command="stop", by="a", token="a.1.1"))
    assert waiting(made) == [("stop", "a.2.1")]


def test_a_new_term_drops_readings_and_keeps_events():
    kept, dropped = proposals(True, b"1", offered=4), proposals(False, b"1", offered=4)
    for made in (kept, dropped):
        made.renew(TERM)
    assert (list(kept.components), list(dropped.components)) == ([b"1"], [])


def test_a_snapshot_holds_what_was_offered_before_it():
    before, after = proposals(True, b"1", offered=4), proposals(True, b"1", offered=4)
    before.forget(4)
    after.forget(3)
    assert (list(before.components), list(after.components)) == ([], [b"1"])


def test_a_snapshot_may_hold_a_stop():
    made = proposals(True)
    made.add(None, asked("reset", "a1"))
    made.forget(3)
    assert voided(made) == [("a1", "steps that this agent does not know may have stopped the team")]


def test_what_waits_is_bounded():
    made = proposals(True, *[b"%d" % number for number in range(WAITING + 2)])
    assert list(made.components)[:2] == [b"0", b"3"]
    for _ in range(COMMANDS + 1):
        made.add(None, asked("stop"))
    assert (len(made.components), len(made.commands), made.dropped) == (WAITING, COMMANDS, 3)
    made.add(None, asked("start", "a1"))
    assert (len(made.commands), voided(made)) == (COMMANDS, [("a1", "16 commands wait before it")])
