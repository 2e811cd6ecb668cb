"""Faults that are planted in the agreement, each of which random schedules find."""

from __future__ import annotations

import pytest
from team.schedules import violation

from mdm.team.agreement import Agreement
from mdm.team.agreement.messages import Commit, Term
from mdm.team.agreement.proposals import Hold, Proposals
from mdm.team.agreement.state import Ballot


class WithoutFence(Agreement):
    """Applies what comes of older terms."""

    def receive(self, sender, incarnation, message, now):
        if isinstance(message, Commit) and message.term < self.term:
            if self.state.ballot is None and self.state.sound:
                self._receive_commit(message, now)
            return self._flush()
        return super().receive(sender, incarnation, message, now)


class OutOfOrder(Agreement):
    """Applies a commit without those before it."""

    def _receive_commit(self, commit, now):
        if self.state.begun and commit.step > self.step and commit.digest:
            self._apply(commit)
        else:
            super()._receive_commit(commit, now)


class LateCounts(Agreement):
    """Counts a late component under the present step."""

    def _counts(self, sender, step, now):
        return super()._counts(sender, step, now) or (self.state.role == "leading" and sender in self._ballot.joined)


class Unasked(Ballot):
    """Goes on from the leader's own history, and waits for nobody."""

    def enough(self, majority):
        return True

    def source(self, leader, *, by_side):
        return leader


class WithoutSource(Ballot):
    """Asks, and then goes on from the leader's own history all the same."""

    def source(self, leader, *, by_side):
        return leader


class WithoutLog(Agreement):
    """Joins with nothing of what was applied before."""

    def _receive_begin(self, begin, now):
        if begin.position != self.log.position:
            self.log.replace((begin.position,), 0)
            self._take_part()
            self._acknowledge(now)
        else:
            super()._receive_begin(begin, now)


class WithoutMajority(Agreement):
    """Commits a step though no majority is known to have applied the last."""

    def _is_ready(self):
        self.state.applied.update(dict.fromkeys(self.agents, self.step))
        return super()._is_ready()


class SameTerm(Agreement):
    """Forgets at a restart which terms it has called."""

    def _enter(self, term):
        super()._enter(Term(term.number, term.leader, 0) if term.leader == self.agent else term)

    def _is_mine(self):
        return self.term.leader == self.agent


PLANTED = {
    "no fence": (WithoutFence, None),
    "out of order": (OutOfOrder, None),
    "late components": (LateCounts, None),
    "not asking": (Agreement, Unasked),
    "not listening": (Agreement, WithoutSource),
    "a joiner without log": (WithoutLog, None),
    "no majority": (WithoutMajority, None),
    "a term again": (SameTerm, None),
}


class Ageless(Proposals):
    """Keeps commands from one term to the next."""

    def renew(self, term):
        kept = tuple(self.commands)
        super().renew(term)
        self.commands.extend(asked for asked in kept if asked not in self.commands)
        self.void.clear()


class Equal(Proposals):
    """Has a stop beat nothing that was asked for before it."""

    def _discard(self, which, reason):
        if "stop" not in reason:
            super()._discard(which, reason)


class Unheld(Hold):
    """Does what is decided, whatever this agent was told."""

    @property
    def still(self):
        return False

    @still.setter
    def still(self, still):
        pass


COMMANDS = {
    "commands without age": {"agreement.Proposals": Ageless},
    "a stop that beats nothing": {"agreement.Proposals": Equal},
    "no hold": {"agreement.Hold": Unheld},
}


@pytest.mark.parametrize("fault", COMMANDS)
def test_a_planted_fault_of_commands_is_found(fault, monkeypatch):
    for place, planted in COMMANDS[fault].items():
        monkeypatch.setattr(f"mdm.team.agreement.{place}", planted)
    assert any("was asked for" in (violation(seed)[1] or "") for seed in range(1000))


@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_found(fault, monkeypatch):
    machine, ballot = PLANTED[fault]
    if ballot is not None:
        monkeypatch.setattr("mdm.team.agreement.agreement.Ballot", ballot)
    assert any(violation(seed, machine=machine)[1] for seed in range(400))
