"""What keeps an agent stopped: a stop, until a start that is known to have been asked for after it."""

from __future__ import annotations

from team.lockstep import Lockstep

from mdm.team.agreement.messages import Commit, Position, Term
from mdm.team.agreement.proposals import Hold

FIRST, SECOND = Term(1, "a", 1), Term(2, "b", 1)


def step(number, command, token, by="b", term=FIRST):
    commit = Commit(term, number, term, {}, (), command, by, "", token)
    return commit, Position(term, number)


def test_a_stop_holds_until_the_next_start():
    hold = Hold("a")
    hold.take(*step(1, "stop", "b1"))
    assert hold.still
    hold.take(*step(2, "reset", "b2"))
    hold.take(*step(3, "begin", "b3"))
    assert hold.still
    hold.take(*step(4, "start", "b4"))
    assert not hold.still


def test_a_stop_that_is_no_step_yet_holds_through_starts():
    hold = Hold("a")
    hold.stop("a1")
    hold.take(*step(1, "start", "b1"))
    hold.take(*step(2, "stop", "a1"))  # of another agent that was asked for the same
    assert (hold.still, hold.waits) == (True, "a1")
    hold.take(*step(3, "stop", "a1", by="a"))
    assert (hold.still, hold.waits) == (True, "")
    hold.take(*step(4, "start", "b2"))
    assert not hold.still


def test_another_history_starts_an_agent_only_where_its_stop_is_in_it():
    for lineage, still in (((Position(FIRST, 7),), False), ((Position(FIRST, 2), Position(SECOND, 9)), True)):
        hold = Hold("a")
        hold.take(*step(3, "stop", "b1"))
        hold.restore(lineage, running=True)
        assert (hold.still, hold.waits) == (still, "b1" if still else "")


def test_another_history_tells_nothing_of_starts_after_a_hold():
    hold = Hold("a")
    hold.stop("a1")
    hold.take(*step(3, "hold", "a1", by="a"))
    hold.restore((Position(FIRST, 7),), running=True)
    assert (hold.still, hold.waits) == (True, "")


def test_who_was_stopped_alone_has_a_hold_made_and_the_others_go_on():
    team = Lockstep(3)
    team.deliver()
    team.propose("a", None, "start")
    team.deliver()
    team.divide("ab", "c")
    team.propose("c", None, "stop")
    team.deliver()
    team.heal()
    team.deliver()
    assert [commit.command for commit in team["a"].log.commits] == ["start", "hold"]
    assert [team[agent].hold.still for agent in "abc"] == [False, False, True]
    team.propose("b", None, "start")
    team.deliver()
    assert [team[agent].hold.still for agent in "abc"] == [False, False, False]


def test_a_side_that_was_stopped_stays_so_where_the_history_of_the_other_counts():
    team = Lockstep(2, mode="continue")
    team.deliver()
    team.divide("a", "b")
    team.deliver()
    team.wait(10_000)
    team.propose("a", None, "start")
    team.propose("b", None, "stop")
    team.deliver()
    assert [team[agent].replica.running for agent in "ab"] == [True, False]
    team.propose("a", b"1")
    team.propose("a", None, "reset")
    team.wait(10_000)
    team.heal()
    team.wait(10_000)
    assert team.equal
    assert [team[agent].replica.running for agent in "ab"] == [True, True]
    assert [team[agent].hold.still for agent in "ab"] == [False, True]
