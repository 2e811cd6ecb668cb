"""The state machine of modes: its table, an exhaustive search of small worlds, and random long ones."""

from __future__ import annotations

import copy

import pytest
from hypothesis import settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from mdm.actors.safety.modes import AT_INPUT, AT_STIMULUS, WAYS_BACK, Aim, Modes, Order, Stage, Try

CAUSES = ("impossible_observation", "deadline", "stale_input", "action", "mine", "lost_majority")
TEAM = frozenset({"refused", "lost_majority"})


def end(modes, time, kind="end"):
    """What is below has ended, too."""
    modes.end_below()
    modes.end_here()
    return modes.end(time, kind)


EVENTS = {
    "start": lambda modes, time: modes.start(time),
    "stop": lambda modes, time: modes.stop(time),
    "release": lambda modes, time: modes.release(time),
    "secured": lambda modes, time: modes.secured(None, time),
    "failed": lambda modes, time: modes.secured("it broke", time),
    "secured early": lambda modes, time: modes.secured(None, time, early=True),
    "failed early": lambda modes, time: modes.secured("it broke", time, early=True),
    "latch": lambda modes, time: modes.latch(),
    "end below": lambda modes, time: modes.end_below(),
    "end": end,
    "stimulus": lambda modes, time: modes.gone(AT_STIMULUS, time),
    "input": lambda modes, time: modes.gone(AT_INPUT, time),
    "known": lambda modes, time: modes.gone(frozenset({"stale_input"}), time),
    "team": lambda modes, time: modes.gone(TEAM, time),
    "refused": lambda modes, time: modes.endanger("refused", "words", time, at_rest=True),
    **{cause: lambda modes, time, cause=cause: modes.endanger(cause, "words", time) for cause in CAUSES},
}


AIMS = {("stopped", Aim.REST), ("stopped", Aim.STOP), ("deciding", Aim.DECIDE), *(("safe", aim) for aim in Aim)}
"""The modes, each with the aims that there are in it."""


class World:
    """What the layers would do: whether decisions start actions, and whether the safe action is under way."""

    def __init__(self):
        self.modes = Modes()
        self.modes.open(0)
        self.admits = False
        self.safe_runs = False
        self.wanted = self.ordered = False  # whether it was told to start, and whether to stop, and not otherwise since
        self.tries = 0
        self.emergencies = 0
        self.time = 0

    def apply(self, event):
        before, ended, stage = self.modes.mode, self.modes.ended, self.modes.stage
        owed = self.modes.safe_action is Try.OWED
        self.time += 1
        if event in {"secured", "failed", "secured early", "failed early"}:
            if not self.safe_runs:
                return
            self.safe_runs = False
        if event == "start" and stage is Stage.OPEN and not ended:
            self.wanted, self.ordered = True, False
        if event == "stop" and stage is not Stage.BELOW:
            self.wanted, self.ordered = False, True
        orders = EVENTS[event](self.modes, self.time)
        if event in {"latch", "end below"}:
            self.admits, orders = False, ()
        for order in orders:
            if order in {Order.ADMIT, Order.RESUME}:
                assert not self.safe_runs, "a decision starts an action beside the safe action"
                assert not self.modes.causes, "decides although a cause holds"
                assert not ended, "there was no way back"
                assert stage is Stage.OPEN, "it starts although what is above ends"
                self.admits = True
            elif order is Order.SECURE:
                assert not self.safe_runs, "the safe action runs twice at once"
                self.admits, self.safe_runs = False, True
                self.tries = self.tries + 1 if owed or event in {"failed", "failed early"} else 1
                assert self.tries <= 2
            elif order is Order.EMERGENCY:
                assert self.tries == 2
                self.emergencies += 1
                self.tries = 0
            elif order is Order.HALT:
                self.admits = False
        after = self.modes.mode
        assert self.admits == self.modes.deciding
        assert self.safe_runs == (self.modes.safe_action in {Try.FIRST, Try.SECOND})
        assert stage.value <= self.modes.stage.value, "a stage comes back"
        if self.modes.safe_action is Try.OWED:
            assert self.modes.stage is Stage.BELOW, "nothing has the safe action run once more"
        assert not self.safe_runs or after == "safe"
        if before == "deciding" and (event in CAUSES or event in {"end", "refused"}):
            assert (after, self.safe_runs) == ("safe", True), "a cause did not start the safe action"
        if before == "safe" and after == "deciding":
            assert event in {"release", "secured", "secured early", "stimulus", "input", "known", "team"}
        if after == "deciding":
            assert self.wanted, "decides although nobody told it to start"
        if before == "stopped" and event in {*CAUSES, "refused"} and stage is Stage.OPEN:
            assert (after == "safe") == (event == "refused" and not self.ordered)
            kept = event != "impossible_observation"  # of which nothing is left to be done
            assert (event in self.modes.causes) >= kept, "a cause that came to it stopped is lost"
        if before == "stopped" and after == "safe":
            assert event in {"start", "end"} or not self.ordered, "who has told it to stop sees it move"
        if event == "team":
            assert TEAM.isdisjoint(self.modes.causes)
        if after != before:
            assert self.modes.since == self.time

    @property
    def key(self):
        modes = self.modes
        hidden = (modes.stage, modes.safe_action, modes.aim)
        told = (self.admits, self.safe_runs, self.wanted, self.ordered, self.tries)
        return (modes.mode, frozenset(modes.causes), hidden, told)


def search(causes):
    """Return the worlds that can be reached by some causes, the other events, and all stages."""
    frontier, seen = [World()], set()
    events = [event for event in EVENTS if event not in CAUSES or event in causes]
    while frontier:
        world = frontier.pop()
        for event in events:
            following = copy.deepcopy(world)
            following.apply(event)
            if following.key not in seen:
                seen.add(following.key)
                frontier.append(following)
    return seen


@pytest.mark.parametrize(
    ("causes", "most"),
    [
        (("impossible_observation", "mine"), 500),
        (("action", "lost_majority"), 500),
        pytest.param(CAUSES, 5000, marks=pytest.mark.slow),
    ],
)
def test_every_small_world_keeps_the_latch(causes, most):
    seen = search(causes)
    assert {(key[0], key[2][2]) for key in seen} == AIMS
    assert len(seen) > most


class Machine(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.world = World()

    @rule(event=st.sampled_from(sorted(EVENTS)))
    def apply(self, event):
        self.world.apply(event)

    @invariant()
    def a_safe_mode_has_a_reason(self):
        modes = self.world.modes
        assert modes.mode != "safe" or modes.causes or modes.securing


Machine.TestCase.settings = settings(max_examples=50, stateful_step_count=60, deadline=None)
TestMachine = Machine.TestCase


def decide():
    modes = Modes()
    assert modes.start(0) == (), "no life has begun"
    modes.open(0)
    assert modes.start(0) == (Order.ADMIT,)
    return modes


@pytest.mark.parametrize(
    ("cause", "gone"),
    [
        ("deadline", AT_STIMULUS),
        ("state", AT_STIMULUS),
        ("policy", AT_STIMULUS),
        ("action", AT_INPUT),
        ("stale_input", frozenset({"stale_input"})),
        ("unknown_input", frozenset({"unknown_input"})),
        ("lost_teammate", frozenset({"lost_teammate"})),
    ],
)
def test_the_way_back_needs_both_the_safe_action_s_end_and_the_cause_s(cause, gone):
    modes = decide()
    assert modes.endanger(cause, "words", 1) == (Order.SECURE,)
    assert modes.secured(None, 2) == ()
    assert modes.gone(gone, 3) == (Order.RESUME,)
    assert modes.endanger(cause, "words", 4) == (Order.SECURE,)
    assert modes.gone(gone, 5) == ()
    assert modes.secured(None, 6) == (Order.RESUME,)


def test_several_causes_hold_together():
    modes = decide()
    modes.endanger("deadline", "late", 1)
    assert modes.endanger("stale_input", "old", 2) == ()
    modes.secured(None, 3)
    assert modes.gone(AT_STIMULUS, 4) == ()
    assert [(cause.kind, cause.since) for cause in modes.causes.values()] == [("stale_input", 2)]
    assert modes.gone(frozenset({"stale_input"}), 5) == (Order.RESUME,)


@pytest.mark.parametrize("kind", ["failure", "end"])
def test_nobody_releases_a_failure_or_the_end(kind):
    modes = decide()
    assert end(modes, 1, kind) == (Order.SECURE,)
    modes.secured(None, 2)
    assert modes.release(3) == ()
    assert modes.mode == "safe"
    assert modes.stop(4) == (Order.IDLE,)
    assert modes.start(5) == ()


def test_a_safe_action_that_fails_twice_is_an_emergency():
    modes = decide()
    modes.endanger("deadline", "late", 1)
    assert modes.secured("broken", 2) == (Order.SECURE,)
    assert modes.secured("broken", 3) == (Order.EMERGENCY,)
    assert modes.gone(AT_STIMULUS, 4) == ()
    assert modes.release(5) == (Order.RESUME,)


def test_a_safe_action_that_began_too_early_to_be_the_last_word_runs_once_more_and_may_fail_once():
    modes = decide()
    modes.endanger("impossible_observation", "words", 1)
    end(modes, 2)
    assert modes.secured(None, 3, early=True) == (Order.SECURE,)
    assert modes.securing
    assert modes.secured("broken", 4) == (Order.SECURE,)
    assert modes.secured("broken", 5, early=True) == (Order.EMERGENCY, Order.SECURE)
    assert modes.secured(None, 6) == ()
    assert (modes.mode, modes.securing) == ("safe", False)


def test_what_was_told_to_stop_stops_only_when_its_safe_action_has_run_once_more():
    modes = decide()
    modes.endanger("deadline", "late", 1)
    assert modes.stop(2) == ()
    end(modes, 3)
    assert modes.secured(None, 4, early=True) == (Order.SECURE,)
    assert modes.secured(None, 5) == (Order.IDLE,)


def test_every_cause_of_the_table_has_its_way_back():
    for cause, way in WAYS_BACK.items():
        modes = decide()
        modes.endanger(cause, "words", 1)
        assert modes.secured(None, 2) == ((Order.RESUME,) if way == "at once" else ())
        released = modes.release(3)
        assert (released == (Order.RESUME,)) == (way not in {"at once", "restart", "never"})


def test_a_safe_action_that_fails_while_what_is_below_ends_runs_once_more_when_that_is_over():
    modes = decide()
    modes.endanger("deadline", "late", 1)
    assert modes.end_below()
    assert not modes.end_below()
    assert modes.secured("broken", 2) == ()
    assert modes.safe_action is Try.OWED
    modes.end_here()
    assert modes.end(3) == (Order.SECURE,)
    assert modes.secured("broken", 4) == (Order.EMERGENCY,)
    assert modes.finish()
    assert not modes.finish()


def test_what_ends_goes_safe_and_nothing_of_it_starts():
    modes = decide()
    modes.latch()
    assert not modes.deciding
    assert modes.endanger("deadline", "late", 1) == (Order.SECURE,)
    assert modes.secured(None, 2) == ()
    assert modes.gone(AT_STIMULUS, 3) == ()
    assert not modes.deciding
    assert end(modes, 4) == (Order.SECURE,)


def test_a_new_life_keeps_what_no_restart_mends():
    modes = decide()
    modes.endanger("deadline", "late", 1)
    modes.secured("broken", 2)
    modes.secured("broken", 3)
    end(modes, 4, "failure")
    modes.finish()
    modes.close()
    assert modes.ending
    modes.open(5)
    assert (modes.mode, modes.since, [*modes.causes]) == ("stopped", 5, ["safe_action"])
    assert modes.start(6) == (Order.SECURE,)


@pytest.mark.parametrize("kind", ["lost_teammate", "deadline", "mine"])
def test_a_cause_that_comes_to_what_has_stopped_stands_at_its_start(kind):
    modes = decide()
    modes.stop(1)
    assert modes.endanger(kind, "words", 2) == ()
    assert (modes.mode, [cause.since for cause in modes.causes.values()]) == ("stopped", [2])
    assert modes.start(3) == (Order.SECURE,)
    modes.secured(None, 4)
    assert modes.gone(frozenset({kind}), 5) == (Order.RESUME,)


def test_a_cause_that_is_gone_before_the_start_keeps_nothing():
    modes = decide()
    modes.stop(1)
    modes.endanger("lost_teammate", "words", 2)
    modes.endanger("impossible_observation", "words", 2)  # of which nothing is left to be done
    assert modes.gone(frozenset({"lost_teammate"}), 3) == ()
    assert (modes.causes, modes.start(4)) == ({}, (Order.ADMIT,))


def test_a_stop_takes_away_what_an_input_would_and_not_what_others_tell():
    modes = decide()
    for kind in ("deadline", "stale_input", "lost_majority", "mine"):
        modes.endanger(kind, "words", 1)
    modes.stop(2)
    assert modes.secured(None, 3) == (Order.IDLE,)
    assert [*modes.causes] == ["lost_majority", "mine"]


def test_what_takes_no_part_is_safe_before_its_start_and_stopped_when_that_is_over():
    modes = Modes()
    modes.open(0)
    assert modes.endanger("refused", "words", 1, at_rest=True) == (Order.SECURE,)
    assert (modes.mode, modes.leaving) == ("safe", True)
    modes.secured(None, 2)
    assert modes.mode == "safe"
    assert modes.gone(TEAM, 3) == (Order.IDLE,)
    assert modes.mode == "stopped"
    modes.endanger("refused", "words", 4, at_rest=True)
    modes.secured(None, 5)
    assert modes.start(6) == ()
    assert modes.gone(TEAM, 7) == (Order.RESUME,)


def test_what_was_told_to_stop_does_not_move_where_it_takes_no_part():
    modes = Modes()
    modes.open(0)
    modes.stop(1)
    assert modes.endanger("refused", "words", 2, at_rest=True) == ()
    assert modes.start(3) == (Order.SECURE,)
    modes.secured(None, 4)
    assert modes.stop(5) == (Order.IDLE,)
    assert [*modes.causes] == ["refused"]
