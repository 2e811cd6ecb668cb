from __future__ import annotations

import pytest
from team.lockstep import DEADLINE, RETRY, Lockstep

from mdm.team.agreement import Commit
from mdm.team.agreement.messages import Applied, Component


def last(team, name="a"):
    return team[name].log.commits[-1]


@pytest.mark.parametrize("count", [1, 2, 3, 5])
@pytest.mark.parametrize("mode", ["majority", "continue"])
def test_a_step_is_made_of_all_components_at_once(count, mode):
    team = Lockstep(count, mode=mode)
    for number in range(1, 4):
        team.step(**{name: name.encode() for name in team.names})
        assert team.steps == [number] * count
        assert last(team).inputs == {name: name.encode() for name in team.names}
        assert last(team).missing == ()
    assert team.now == 0
    assert team.equal


def test_who_saw_nothing_is_not_missing():
    team = Lockstep(2)
    team.step(a=b"left", b=None)
    assert (last(team).inputs, last(team).missing) == ({"a": b"left"}, ())


def test_a_step_waits_for_a_component_until_its_deadline():
    team = Lockstep(3)
    team.step(a=b"1", b=b"2")
    team.wait(DEADLINE - 1)
    assert team.steps == [0, 0, 0]
    team.wait(1)
    assert team.steps == [1, 1, 1]
    assert last(team).missing == ("c",)


def test_a_late_component_counts_for_no_step():
    team = Lockstep(3)
    team.step(a=b"1", b=b"2")
    late = team["c"].propose(b"3", team.now)
    team.wait(DEADLINE)
    team.took("c", late)
    team.deliver()
    assert team["a"].late == 1
    assert not team["a"].state.components
    team.step(a=b"4", b=b"5", c=b"6")
    assert last(team).inputs == {"a": b"4", "b": b"5", "c": b"6"}


def test_an_event_makes_a_step_at_once():
    team = Lockstep(3, event_driven=True)
    team.step(b=b"seen")
    assert team.steps == [1, 1, 1]
    assert (last(team).inputs, last(team).missing) == ({"b": b"seen"}, ())
    team.step(c=None)
    assert team.steps == [1, 1, 1]


def test_events_while_a_step_is_under_way_go_into_the_next_together():
    team = Lockstep(3, event_driven=True)
    for name in ("a", "b", "c", "b"):
        team.propose(name, name.encode())
    team.deliver()
    made = [commit.inputs for commit in team["c"].log.commits]
    assert made == [{"a": b"a"}, {"b": b"b", "c": b"c"}, {"b": b"b"}]


def test_a_slow_agent_holds_event_driven_steps_up_to_the_deadline():
    team = Lockstep(3, event_driven=True)
    for number in range(2):
        team.propose("a", b"%d" % number)
        team.deliver(losing=lambda sender, target, message: sender == "c")
    assert team["a"].step == 1
    team.wait(DEADLINE, losing=lambda sender, target, message: sender == "c")
    assert team["a"].step == 2
    assert last(team).missing == ("c",)


def test_a_step_waits_for_a_majority_to_have_applied_the_last():
    team = Lockstep(3, event_driven=True)
    cut = {"losing": lambda sender, target, message: sender != "a"}
    for number in range(3):
        team.propose("a", b"%d" % number)
        team.wait(5 * DEADLINE, **cut)
    assert team.steps == [1, 1, 1]
    team.wait(RETRY)
    assert team.steps == [3, 3, 3]


def test_going_on_alone_waits_for_nobody_beyond_the_deadline():
    team = Lockstep(2, mode="continue", event_driven=True)
    for number in range(3):
        team.propose("a", b"%d" % number)
    team.wait(5 * DEADLINE, losing=lambda sender, target, message: sender != "a")
    assert team["a"].step == 3
    assert last(team).missing == ("b",)


@pytest.mark.parametrize("event_driven", [False, True])
def test_commands_are_steps_of_their_own_and_one_at_a_time(event_driven):
    team = Lockstep(3, event_driven=event_driven)
    team.propose("b", b"seen", "stop")
    team.propose("c", None, "stop")
    team.propose("a", b"heard")
    team.propose("c", b"felt")
    team.deliver()
    made = [(commit.command, commit.by, set(commit.inputs)) for commit in team["b"].log.commits]
    assert sorted(made[:3], key=str) != made[:3] or len(made) >= 3
    assert {(command, by) for command, by, _ in made if command} == {("stop", "b"), ("stop", "c")}
    assert {agent for _, _, inputs in made for agent in inputs} == {"a", "b", "c"}
    assert all(not inputs for command, _, inputs in made if command)
    assert team.equal


@pytest.mark.parametrize("first", ["start", "stop"])
def test_of_a_start_and_a_stop_that_are_asked_for_at_once_the_stop_counts(first):
    team = Lockstep(3)
    team.deliver()
    agents = {first: "b", ({"start", "stop"} - {first}).pop(): "c"}
    for command, agent in agents.items():
        team.propose(agent, None, command)
    team.deliver()
    assert team["a"].log.commits[-1].command == "stop"
    assert not any(team[agent].replica.running for agent in "abc")
    assert team["a"].hold.still
    assert team.equal


@pytest.mark.parametrize("event_driven", [False, True])
@pytest.mark.parametrize("kind", [Component, Commit, Applied])
def test_what_is_lost_is_said_again(kind, event_driven):
    team = Lockstep(3, event_driven=event_driven)
    lost = []

    def losing(sender, target, message):
        if isinstance(message, kind) and (sender, target) not in lost:
            lost.append((sender, target))
            return True
        return False

    for number in range(3):
        for name in team.names:
            team.propose(name, b"%d" % number)
        team.wait(3 * RETRY, losing=losing)
    team.wait(10 * RETRY)
    assert len(set(team.steps)) == 1
    assert team.steps[0] >= 3
    assert team.equal


def test_a_follower_that_sees_a_gap_asks_for_it_at_once():
    team = Lockstep(3)
    for name in team.names:
        team.propose(name, b"1")
    team.deliver(losing=lambda sender, target, message: isinstance(message, Commit) and target == "c")
    assert team.steps == [1, 1, 0]
    team.wait(DEADLINE // 2, losing=lambda sender, target, message: target == "c")
    team["a"].state.timers.pop("retry", None)
    team.step(a=b"2", b=b"2")
    now = team.now
    team.wait(DEADLINE)
    assert team.steps == [2, 2, 2]
    assert team.now == now + DEADLINE


def test_an_idle_event_driven_team_is_silent():
    team = Lockstep(3, event_driven=True)
    team.step(a=b"1")
    team.wait(100 * RETRY)
    assert [machine.next_time for machine in team.machines.values()] == [None] * 3
