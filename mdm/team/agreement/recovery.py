"""Recovery: the steps that an agent missed, from the log of another, or a snapshot of the whole copy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.team.agreement.entries import Entries, Snapshot
from mdm.team.agreement.history import contains
from mdm.team.agreement.terms import Terms

if TYPE_CHECKING:
    from mdm.team.agreement.entries import Fetch

__all__ = ["Recovery"]

TOGETHER = 64
"""Commits in one message to somebody who missed them."""


class Recovery(Terms):
    """How an agent comes to have what others have applied."""

    def _on_fetch(self, sender: str, message: Fetch, now: int) -> None:
        for_leader = sender == self.term.leader
        leading = self._is_led(sender)
        if not self.begun and not for_leader:
            return
        if message.digest is not None:
            if leading and self._is_ahead(sender, message.position.step, now):
                return
            if for_leader or (leading and self._outvotes(sender, message.position.step, message.digest, now)):
                self._send(sender, self._snapshot())
            return
        commits = self.history.since(message.position, TOGETHER)
        if commits is not None:
            self._send(sender, Entries(self.term, commits))
        elif leading or for_leader:
            self._send(sender, self._snapshot())

    def _snapshot(self) -> Snapshot:
        history = self.history
        return Snapshot(self.term, history.lineage, history.side, self.replica.digest(), self.replica.snapshot())

    def _outvotes(self, sender: str, step: int, digest: str, now: int) -> bool:
        """Return whether the leader's copy counts against a differing one.

        It does once more than half of the members have applied a later step, and so have the same, or no other member
        is left to ask. Where more than half have another copy, the same among them, the leader takes theirs.
        """
        self.doubts[sender] = (step, digest)
        members = [agent for agent in self.members_now if agent in self.present]
        against = sum(1 for agent in members if self.doubts.get(agent) == (step, digest))
        if 2 * against > len(members):
            self.sound = False
            self._report("digest", f"the copy of {self.agent}, which leads, is not what most have after step {step}")
            self._call(now)
            return False
        agreeing = sum(1 for agent in members if self.applied.get(agent, 0) > step)
        doubting = sum(1 for agent in members if self.doubts.get(agent, (None,))[0] == step)
        return 2 * agreeing > len(members) or agreeing + doubting >= len(members)

    def _on_entries(self, sender: str, message: Entries, now: int) -> None:
        if self.fetching is None or not self.sound or (self.ballot is not None and sender != self.fetching):
            return
        for commit in message.commits:
            if self.history.follows(commit) and not self._apply(commit, now):
                return
        source, self.fetching = self.fetching, None
        if self.ballot is not None:
            if not message.commits and self._claims_more(source):
                self._call(now)  # what it is said to have joined with is not so: have all say it anew
            else:
                self._recount(now)
        elif len(message.commits) == TOGETHER:
            self._fetch(self.term.leader, now)
        else:
            self._caught_up(now)

    def _claims_more(self, agent: str) -> bool:
        """Return whether an agent joined this one's term with steps that it does not have."""
        assert self.ballot is not None
        joined = self.ballot.joined.get(agent)
        return joined is not None and not contains(self.history.lineage, joined.lineage[-1])

    def _on_snapshot(self, sender: str, message: Snapshot, now: int) -> None:
        if sender != self.fetching:
            return
        position, history = message.lineage[-1], self.history
        placed = self.begun or (not self.sound and self.ballot is None)
        if placed and position.step < self.step and contains(history.lineage, position):
            return  # it is late: this agent's history is that of the term already
        before = self.replica.snapshot()
        self.replica.restore(message.body)
        if self.replica.digest() != message.digest:
            self.replica.restore(before)
            self._report("digest", f"the snapshot of {sender} after step {position.step} is not what it should be")
            return
        history.replace(message.lineage, message.side)
        self.hold.restore(message.lineage, running=self.replica.running)
        self.proposals.forget(position.step)
        self.sound = True
        self.fetching = None
        if self.ballot is not None:
            self._recount(now)
        else:
            self._caught_up(now)

    def _caught_up(self, now: int) -> None:
        if not self.begun:
            self._place()
        self._acknowledge(now)
