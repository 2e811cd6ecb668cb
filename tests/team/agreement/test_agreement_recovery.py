from __future__ import annotations

import pytest
from team.lockstep import DEADLINE, PATIENCE, RETRY, Lockstep

from mdm.team.agreement.messages import Entries, Fetch, Position, Snapshot


def full(team, times=1, **options):
    for number in range(times):
        for name in team.machines:
            team.propose(name, b"%d" % number)
        team.deliver(**options)


def test_who_missed_some_steps_takes_them_from_the_log():
    team = Lockstep(3)
    team.divide("ab", "c")
    team.deliver()
    full(team, 3)
    kinds = []
    team.heal()
    team.deliver(losing=lambda sender, target, message: kinds.append(type(message)))
    assert team.steps == [3, 3, 3]
    assert Entries in kinds
    assert Snapshot not in kinds


def test_a_command_of_an_earlier_life_in_the_log_is_not_that_of_the_present_one():
    team = Lockstep(3)
    team.propose("b", command="stop")
    team.deliver()
    team.crash("b")
    team.see()
    team.deliver()
    team.propose("a", command="start")
    team.deliver()
    team.start("b")
    team.propose("b", command="stop")  # in no term yet: it holds for b alone
    team.see()
    team.deliver()
    assert team["b"].hold.still
    assert not team["a"].hold.still
    assert [commit.command for commit in team["b"].log.commits] == ["stop", "start", "hold"]
    assert team.equal


def test_who_missed_more_than_the_log_has_takes_a_snapshot():
    team = Lockstep(3, log_size=2)
    team.divide("ab", "c")
    team.deliver()
    full(team, 9)
    kinds = []
    team.heal()
    team.deliver(losing=lambda sender, target, message: kinds.append(type(message)))
    assert team.steps == [9, 9, 9]
    assert Snapshot in kinds


def test_many_steps_come_in_several_messages():
    team = Lockstep(3)
    team.divide("ab", "c")
    team.deliver()
    full(team, 150)
    team.heal()
    team.deliver()
    assert team.steps == [150] * 3


def test_a_joiner_takes_what_it_missed():
    team = Lockstep(3, log_size=4)
    team.crash("c")
    team.see()
    team.deliver()
    full(team, 20)
    team.start("c")
    team.see()
    team.deliver()
    assert team.steps == [20] * 3
    assert team.equal


def test_a_snapshot_of_an_older_term_is_dropped():
    team = Lockstep(3, log_size=1)
    team.divide("ab", "c")
    team.deliver()
    full(team, 5)
    held = []

    def losing(sender, target, message):
        if isinstance(message, Snapshot):
            held.append((sender, team[sender].incarnation, target, message))
            return True
        return False

    team.heal()
    team.deliver(losing=losing)
    assert held
    team.crash("a")
    team.see()
    team.deliver()
    full(team, 2)
    assert team.steps == [7, 7]
    sender, life, _target, message = held[0]
    team["c"].state.live["a"] = life
    team.took("c", team["c"].receive(sender, life, message, team.now))
    assert team["c"].step == 7


def test_an_older_snapshot_of_the_same_term_undoes_nothing():
    team = Lockstep(3)
    full(team, 2)
    old = team["a"]._snapshot()
    full(team, 2)
    team["c"].state.fetching = "a"
    team.took("c", team["c"].receive("a", 1, old, team.now))
    assert team["c"].step == 4


@pytest.mark.parametrize("forged", ["body", "digest", "far", "all"])
def test_a_snapshot_that_the_leader_did_not_send_keeps_nobody_from_further_steps(forged):
    """What is none is dropped, and asked for again; a history ahead of the leader's ends when a term is called."""
    team = Lockstep(3)
    full(team, 3)
    true = team["a"]._snapshot()
    far = (*true.lineage[:-1], Position(true.lineage[-1].term, 2**40))
    digest = "4711" if forged in {"digest", "all"} else true.digest
    lineage = far if forged in {"far", "all"} else true.lineage
    body = true.body.replace(b"True", b"None") + b" " if forged == "body" else true.body
    team.watched = False
    team.oracle.applies = team.oracle.restores = team.oracle.hears = lambda *_: None  # it knows of true steps alone
    team["c"].state.fetching = "a"
    team.took("c", team["c"].receive("a", 1, Snapshot(true.term, lineage, true.side, digest, body), team.now))
    told = [text for kind, text in team["c"].reports if kind == "digest"]
    if digest == "4711":
        assert told == [f"the snapshot of a after step {lineage[-1].step} is not what it should be"]
    for number in range(8):
        for name in team.machines:
            team.propose(name, b"%d" % number)
        team.wait(2 * DEADLINE)
    assert len(set(team.steps)) == 1
    assert team.equal
    assert team.roles == ["leading", "following", "following"]
    before = team.steps
    full(team)
    assert team.steps == [step + 1 for step in before]


@pytest.mark.parametrize("kind", [Fetch, Entries, Snapshot])
def test_what_is_lost_is_asked_for_again(kind):
    team = Lockstep(3, log_size=1)
    team.divide("ab", "c")
    team.deliver()
    full(team, 1 if kind is Entries else 5)
    lost = []

    def losing(sender, target, message):
        lost.extend([kind] if isinstance(message, kind) and not lost else [])
        return isinstance(message, kind) and len(lost) == 1 and not lost.append(kind)

    team.heal()
    team.wait(3 * RETRY, losing=losing)
    assert lost
    assert len(set(team.steps)) == 1
    assert team.equal


def test_a_follower_fetches_from_others_when_the_leader_does_not_answer():
    team = Lockstep(3)
    deaf = {"losing": lambda sender, target, message: (sender, target) == ("a", "c")}
    full(team, 1, **deaf)
    assert team.steps == [1, 1, 0]
    team["c"]._fetch("a", team.now)
    team.took("c", team["c"]._flush())
    team.wait(2 * RETRY, **deaf)
    assert team.steps == [1, 1, 1]


def test_a_copy_that_differs_stops_says_so_and_takes_the_leader_s():
    team = Lockstep(3)
    full(team, 2)
    team["c"].replica.value = 4711
    team.watched = False
    full(team)
    team.wait(3 * RETRY)
    assert team.steps == [3, 3, 3]
    assert team.equal
    [(kind, text)] = team["c"].reports
    assert kind == "digest"
    assert text == "the copy of c after step 2 is 4711, another than at a"
    full(team)
    assert team.steps == [4, 4, 4]


@pytest.mark.parametrize("count", [3, 4, 5])
def test_a_leader_that_differs_from_most_takes_theirs(count):
    team = Lockstep(count)
    full(team, 2)
    sound = team["b"].replica.value
    team["a"].replica.value = 4711
    team.watched = False
    team.oracle.values = Forgiving(team.oracle.values)
    full(team)
    team.wait(PATIENCE)
    assert [report for report in team["a"].reports if report[0] == "digest"]
    assert team.oracle.values[team["b"].log.position] == team["b"].replica.value
    assert team.equal
    assert team["a"].step == team["b"].step == 2
    assert team["a"].replica.value == sound
    full(team)
    assert team.steps == [3] * count


def test_a_leader_that_differs_from_most_when_it_calls_takes_theirs():
    team = Lockstep(4)
    full(team, 2)
    sound = team["b"].replica.value
    team["a"].replica.value = 4711
    team.crash("d")
    team.see()
    team.deliver()
    assert team.roles == ["leading", "following", "following"]
    assert team["a"].replica.value == sound


def test_of_two_the_leader_s_copy_counts():
    team = Lockstep(2)
    full(team, 2)
    team["b"].replica.value = 4711
    team.watched = False
    full(team)
    assert team.steps == [3, 3]
    assert team.equal


class Forgiving(dict):
    """Values of copies, of which one is spoilt on purpose."""

    def setdefault(self, key, value):
        self[key] = value
        return value


def test_who_lost_its_leader_while_it_caught_up_does_not_follow_it():
    team = Lockstep(3)
    full(team)
    team["c"].state.suspend()
    team["c"]._fetch("a", team.now)
    team.took("c", team["c"].members({"b": 2, "c": 3}, team.now))
    team.took("c", team["c"].receive("b", 2, Entries(team["c"].term, ()), team.now))
    assert team["c"].role == "joining"
