from __future__ import annotations

import inspect
import re

import pytest
from places import ROOT
from team.lockstep import PATIENCE, RETRY, Lockstep

from mdm.team.agreement import Agreement, Term
from mdm.team.agreement.messages import (
    START,
    Applied,
    Begin,
    Command,
    Component,
    Ended,
    Joined,
    Position,
    Stale,
)


def test_messages_of_who_is_not_seen_are_dropped():
    team = Lockstep(3)
    component = Component(team["a"].term, 1, b"1")
    for sender, life in (("b", 7), ("x", 2), ("a", 1)):
        late = team["a"].late
        assert team["a"].receive(sender, life, component, 0) == []
        assert team["a"].late == late + 1
    assert not team["a"].state.components


def test_messages_of_an_older_term_are_refused_with_the_present_one():
    team = Lockstep(3)
    team.crash("c")
    team.see()
    team.deliver()
    old = Term(1, "a", 1)
    for message in (Component(old, 1, b"1"), Command(old, 1, "stop"), Applied(old, 1)):
        [send] = team["a"].receive("b", 2, message, 0)
        assert send.message == Stale(Term(2, "a", 1))
        assert send.to == "b"
    assert team["a"].receive("b", 2, Stale(old), 0) == []
    assert not team["a"].state.components


def test_steps_and_ends_of_others_than_the_leader_are_dropped():
    team = Lockstep(3)
    for message in (Begin(team["a"].term, START, "1", ()), Ended(team["a"].term)):
        assert team["c"].receive("b", 2, message, 0) == []
        assert team["c"].role == "following"


def test_a_leader_that_learns_of_a_newer_term_calls_a_newer_one():
    team = Lockstep(3)
    team.took("a", team["a"].receive("b", 2, Stale(Term(7, "b", 2)), 0))
    assert team["a"].role == "joining"
    assert team["a"].term == Term(8, "a", 1)
    team.wait(PATIENCE)
    assert team.roles == ["leading", "following", "following"]


def test_a_name_of_nobody_in_a_term_does_no_harm():
    team = Lockstep(3)
    term = team["a"].term
    assert team["a"].receive("b", 2, Stale(Term(7, "nobody", 2)), 0) == []
    assert team["a"].term == term


@pytest.mark.parametrize("said", [Applied, Component, Command])
def test_who_says_that_it_is_ahead_of_its_leader_holds_no_step_up(said):
    team = Lockstep(3)
    more = {Applied: (2**40,), Component: (2**40, b"1"), Command: (2**40, "stop")}[said]
    team.took("a", team["a"].receive("b", team["b"].incarnation, said(team["a"].term, *more), team.now))
    for name in team.names:
        team.propose(name, b"1")
    team.deliver()
    assert team.steps == [1, 1, 1]


def test_who_joins_with_steps_that_it_does_not_have_holds_no_term_up():
    team = Lockstep(3)
    for name in team.names:
        team.propose(name, b"1")
    team.deliver()
    leader = team["a"]
    leader._call(team.now)
    lie = Joined(leader.term, (START, Position(Term(1, "b", 1), 2**40)), 3, "4711", True)
    team.took("a", leader._flush() + leader.receive("b", team["b"].incarnation, lie, team.now))
    team.wait(2 * PATIENCE)
    assert team.roles == ["leading", "following", "following"]


def test_time_that_stands_still_or_jumps_is_no_matter():
    team = Lockstep(3)
    for name in team.names:
        team.propose(name, b"1")
    team.deliver(losing=lambda sender, target, message: target == "b")
    team.now += 10**15
    for name in team.names:
        team.took(name, team[name].tick(team.now))
    team.wait(3 * RETRY)
    assert team.steps == [1, 1, 1]


def test_a_thousand_steps_leave_nothing_behind():
    team = Lockstep(3, log_size=10)
    for number in range(1000):
        team.step(**dict.fromkeys(team.names, b"%d" % number))
    for machine in team.machines.values():
        assert machine.step == 1000
        assert len(machine.log.commits) < 20
        assert not machine.state.components
        assert not machine.proposals.components
        assert len(machine.log.lineage) == 2


@pytest.mark.parametrize("role", ["leading", "calling", "following", "joining"])
def test_each_role_takes_the_messages_that_the_page_says(role):
    page = (ROOT / "docs" / "design" / "agreement.md").read_text(encoding="utf-8")
    taken = re.search(rf"^\| {role} \|[^|]*\|([^|]*)\|", page, re.MULTILINE).group(1)
    step = "led" if role in {"following", "joining"} else role
    source = inspect.getsource(getattr(Agreement, f"_step_{step}"))
    cases = {name for line in re.findall(r"case (.*):", source) for name in re.findall(r"[A-Z]\w+(?=\()", line)}
    assert set(re.findall(r"`(\w+)`", taken)) == cases
