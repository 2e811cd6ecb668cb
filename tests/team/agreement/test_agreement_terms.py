from __future__ import annotations

from team.lockstep import PATIENCE, RETRY, Lockstep

from mdm.team.agreement import Term
from mdm.team.agreement.messages import Begin, Call, Joined, Snapshot


def full(team, times=1):
    team.deliver()
    for number in range(times):
        team.step(**dict.fromkeys(team.machines, b"%d" % number))


def test_the_first_of_the_live_agents_leads():
    team = Lockstep(3)
    assert team.roles == ["leading", "following", "following"]
    assert {machine.term for machine in team.machines.values()} == {Term(1, "a", 1)}
    assert [machine.leader for machine in team.machines.values()] == ["a"] * 3
    assert [machine.state.members for machine in team.machines.values()] == [("a", "b", "c")] * 3


def test_the_next_one_leads_when_the_leader_crashes_and_what_was_applied_stays():
    team = Lockstep(3)
    full(team, 2)
    team.crash("a")
    team.see()
    full(team)
    assert team.roles == ["leading", "following"]
    assert team["b"].term == Term(2, "b", 2)
    assert team.steps == [3, 3]
    assert team["c"].log.commits[-1].missing == ("a",)


def test_a_step_that_one_survivor_applied_is_not_lost_with_its_leader():
    team = Lockstep(3)
    for name in team.names:
        team.propose(name, b"1")
    team.deliver(losing=lambda sender, target, message: sender == "a" and target == "b")
    assert team.steps == [1, 0, 1]
    team.crash("a")
    team.see()
    team.deliver()
    assert team.steps == [1, 1]
    assert team.equal


def test_a_leader_that_returns_leads_in_a_term_of_its_own():
    team = Lockstep(3)
    full(team, 3)
    team.crash("a")
    team.see()
    full(team)
    team.start("a")
    team.see()
    team.deliver()
    team.wait(PATIENCE)
    assert team["a"].term.incarnation == 4
    assert team["a"].term > Term(2, "b", 2)
    assert team.steps == [4, 4, 4]
    assert sorted(team.roles) == ["following", "following", "leading"]
    assert team["a"].role == "leading"
    assert team.equal


def test_a_leader_that_restarts_unseen_uses_no_term_again():
    team = Lockstep(3)
    full(team, 3)
    before = team["a"].term
    team.start("a")
    team.see("a")
    team.see()
    team.deliver()
    team.wait(PATIENCE)
    assert team["a"].term.number > before.number
    assert team.steps == [3, 3, 3]


def test_a_leader_that_hung_and_comes_back_does_not_go_on():
    team = Lockstep(3)
    full(team)
    team.propose("b", b"2")
    team.propose("c", b"2")
    team.deliver(losing=lambda sender, target, message: target == "a")
    waiting = list(team.line)
    team.cut = {(one, other) for one in "a" for other in "bc"} | {(one, other) for one in "bc" for other in "a"}
    team.see("bc")
    full_side = {"b": b"3", "c": b"3"}
    team.deliver()
    team.step(**full_side)
    assert [team[name].step for name in "bc"] == [2, 2]
    team.cut = set()
    team.line.extend(waiting)
    team.propose("a", b"2")
    team.wait(PATIENCE)
    team.see()
    team.wait(PATIENCE)
    full(team)
    assert len(set(team.steps)) == 1
    assert team.equal


def test_a_side_without_majority_waits_and_returns():
    team = Lockstep(3)
    full(team)
    team.divide("a", "bc")
    team.deliver()
    full(team, 2)
    assert team.roles == ["waiting", "leading", "following"]
    assert team.steps == [1, 3, 3]
    assert team["a"].reports == [("majority", "a sees 1 of 3 agents and waits for more")]
    team.heal()
    team.wait(PATIENCE)
    assert team.steps == [3, 3, 3]
    assert team["a"].role == "leading"
    assert team.equal


def test_two_that_both_went_on_become_one():
    team = Lockstep(2, mode="continue")
    full(team)
    team.divide("a", "b")
    team.deliver()
    full(team, 3)
    team.step(b=b"more")
    team.wait(PATIENCE)
    assert team.steps == [4, 5]
    assert not team.equal
    team.heal()
    team.wait(PATIENCE)
    assert team.steps == [5, 5]
    assert team.equal


def test_the_larger_side_s_history_counts():
    team = Lockstep(3, mode="continue")
    full(team)
    team.divide("ab", "c")
    team.deliver()
    full(team)
    for _ in range(4):
        team.step(c=b"alone")
    assert team.steps == [2, 2, 6]
    team.heal()
    team.wait(PATIENCE)
    assert team.steps == [2, 2, 2]
    assert team.equal


def test_an_agent_that_may_go_on_alone_waits_for_the_others_at_the_start():
    team = Lockstep(2, mode="continue", start=False)
    team.start("a")
    team.see()
    team.wait(PATIENCE - 1)
    assert team["a"].role == "joining"
    team.wait(1)
    assert team["a"].role == "leading"


def test_a_term_does_not_wait_for_ever_for_a_live_agent_that_is_silent():
    team = Lockstep(3, start=False)
    for name in team.names:
        team.start(name)
    silent = {"losing": lambda sender, target, message: sender == "c"}
    team.see()
    team.wait(PATIENCE - 1, **silent)
    assert team["a"].role == "joining"
    team.wait(1, **silent)
    assert team["a"].role == "leading"
    term = team["a"].term
    team.wait(2 * RETRY)
    assert team.roles == ["leading", "following", "following"]
    assert team["c"].term == term
    assert team["b"].state.members == ("a", "b", "c")


def test_views_that_differ_settle_on_one_leader():
    team = Lockstep(3)
    full(team)
    team.cut = {("a", "b"), ("b", "a")}
    for name, seen in (("a", "ac"), ("b", "bc"), ("c", "abc")):
        team.took(name, team[name].members({other: team[other].incarnation for other in seen}, team.now))
    team.wait(5 * PATIENCE)
    term = team["c"].term
    assert team["c"].leader == "a"
    for _ in range(3):
        team.step(a=b"1", c=b"2")
    team.wait(10 * PATIENCE)
    assert team["c"].term == term
    assert (team["a"].step, team["c"].step) == (4, 4)
    assert team["b"].role == "waiting"
    team.heal()
    team.wait(PATIENCE)
    assert team.steps == [4, 4, 4]


def test_an_agent_with_a_majority_leads_where_the_first_has_none():
    team = Lockstep(5)
    team.cut = {(one, other) for one in "a" for other in "cde"} | {(one, other) for one in "cde" for other in "a"}
    for name, seen in (("a", "ab"), ("b", "abcde"), ("c", "bcde"), ("d", "bcde"), ("e", "bcde")):
        team.took(name, team[name].members({other: team[other].incarnation for other in seen}, team.now))
    team.wait(10 * PATIENCE)
    assert team["e"].leader is not None
    assert [team[name].role for name in "cde"].count("waiting") == 0
    full(team)
    team.wait(PATIENCE)
    assert [team[name].step for name in "cde"] == [1, 1, 1]


def test_others_wait_while_the_leader_takes_what_it_lacks():
    team = Lockstep(3, log_size=1)
    team.divide("a", "bc")
    full(team, 5)

    def losing(sender, target, message):
        return isinstance(message, Snapshot)

    team.heal()
    team.wait(PATIENCE, losing=losing)
    term = team["a"].term
    team.wait(10 * PATIENCE, losing=losing)
    assert team.roles == ["joining"] * 3
    assert team["a"].term == term
    team.wait(2 * RETRY)
    assert team.roles == ["leading", "following", "following"]
    assert team.steps == [5, 5, 5]


def test_lost_calls_and_answers_are_said_again():
    for kind in (Call, Joined, Begin):
        team, lost = Lockstep(3, start=False), []

        def losing(sender, target, message, kind=kind, lost=lost):
            if isinstance(message, kind) and (sender, target) not in lost:
                lost.append((sender, target))
                return True
            return False

        for name in team.names:
            team.start(name)
        team.see()
        team.wait(4 * RETRY, losing=losing)
        assert lost
        assert team.roles == ["leading", "following", "following"]
