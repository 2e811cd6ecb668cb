from __future__ import annotations

from mdm.team.agreement.entries import Commit, Term
from mdm.team.agreement.proposals import COMMANDS, WAITING, Proposals

TERM = Term(1, "a", 1)


def proposals(event_driven, *components, offered=None):
    made = Proposals("a", event_driven=event_driven)
    for component in components:
        made.add(component, None)
    made.offered = None if offered is None else (TERM, offered)
    return made


def commit(step, inputs=(), command=None, by=""):
    return Commit(TERM, step, TERM, dict(inputs), (), command, by, "")


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
    made.add(None, "stop")
    made.commanded = (TERM, 1)
    made.settle(commit(1, command="stop", by="b"))
    assert list(made.commands) == ["stop"]
    made.commanded = (TERM, 2)
    made.settle(commit(2, command="stop", by="a"))
    assert not made.commands


def test_a_command_that_an_earlier_life_gave_is_not_this_one():
    made = proposals(True)
    made.add(None, "stop")
    made.settle(commit(1, command="stop", by="a"))
    assert list(made.commands) == ["stop"]


def test_a_new_term_drops_readings_and_keeps_events():
    kept, dropped = proposals(True, b"1", offered=4), proposals(False, b"1", offered=4)
    for made in (kept, dropped):
        made.renew()
    assert (list(kept.components), list(dropped.components)) == ([b"1"], [])


def test_a_snapshot_holds_what_was_offered_before_it():
    before, after = proposals(True, b"1", offered=4), proposals(True, b"1", offered=4)
    before.forget(4)
    after.forget(3)
    assert (list(before.components), list(after.components)) == ([], [b"1"])


def test_what_waits_is_bounded():
    made = proposals(True, *[b"%d" % number for number in range(WAITING + 2)])
    assert list(made.components)[:2] == [b"0", b"3"]
    for _ in range(COMMANDS + 1):
        made.add(None, "stop")
    assert (len(made.components), len(made.commands), made.dropped) == (WAITING, COMMANDS, 3)
