"""Terms: who calls them, who joins, and when they begin."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.team.agreement.ballot import Ballot
from mdm.team.agreement.entries import START, Call, Ended, Stale, Term
from mdm.team.agreement.steps import Steps

if TYPE_CHECKING:
    from mdm.team.agreement.entries import Joined

__all__ = ["Terms"]


class Terms(Steps):
    """Who leads, and when a term begins."""

    def _review(self, now: int) -> None:
        """Look whether a new term is wanted, and who is to call it."""
        self.present = self.live
        if self.barred:
            self._resign()
            self.timers.clear()
            return
        if self.ballot is None and self.present.get(self.term.leader) != self.term.incarnation:
            self._stop()
        if len(self.present) < self.majority:
            self._wait_for_majority(now)
            return
        self.enough = True
        first = next(iter(self.present))
        if self.ballot is not None:
            wanted = self.ballot.invited != self.present
        else:
            wanted = not self.begun or first == self.agent
        if not wanted:
            self.timers.pop("call", None)
        elif self.majority == 1 and self.term == START.term and len(self.present) < len(self.agents):
            self.timers.setdefault("call", now + self.patience)
        elif first == self.agent:
            self._call(now)
        else:
            self.timers.setdefault("call", now + self.patience * (1 + list(self.present).index(self.agent)))

    def _wait_for_majority(self, now: int) -> None:
        self.timers.pop("call", None)
        if self.enough:
            self.enough = False
            seen = f"{len(self.present)} of {len(self.agents)} agents"
            self._report("majority", f"{self.agent} sees {seen} and waits for more")
        if self.ballot is not None:
            self._resign()
            self._send(None, Ended(self.term))
            self.timers["retry"] = now + self.retry

    def _resign(self) -> None:
        """Lead no more."""
        self._stop()
        self.ballot = None
        self.timers.pop("patience", None)
        self.timers.pop("invite", None)

    def _call(self, now: int) -> None:
        self._enter(Term(max(self.heard, self.term.number) + 1, self.agent, self.incarnation))
        self.ballot = Ballot(self.present)
        self.ballot.joined[self.agent] = self._own()
        self.timers["patience"] = now + self.patience
        if len(self.present) > 1:
            self.timers["invite"] = now + self.retry
            self._send(None, self._invitation())
        self._count(now)

    def _invitation(self) -> Call:
        assert self.ballot is not None
        return Call(self.term, self.ballot.invited)

    def _invite(self, now: int) -> None:
        """Call those again who have not joined."""
        assert self.ballot is not None
        absent = [agent for agent in self.ballot.invited if agent not in self.ballot.joined]
        for agent in absent:
            self._send(agent, self._invitation())
        if absent:
            self.timers["invite"] = now + self.retry

    def _bound(self, caller: str) -> bool:
        """Return whether this agent stays with the leader that it has, who comes before the caller."""
        leader = self.term.leader
        if leader == self.agent or self.released or self.present.get(leader) != self.term.incarnation:
            return False
        return self.order[leader] < self.order[caller]

    def _prevails(self, caller: str) -> bool:
        """Return whether it is on this agent to call, and not on the caller."""
        leads = self.ballot is not None or next(iter(self.present), None) == self.agent
        return leads and len(self.present) >= self.majority and self.order[self.agent] < self.order[caller]

    def _newer(self, term: Term, now: int) -> None:
        """Take note of a newer term, of its leader or of one that joined it: apply no more in this one."""
        leader = term.leader
        if term.number < self.term.number or term == self.term or leader not in self.order or self._bound(leader):
            return
        self.heard = max(self.heard, term.number)
        lives = self.present.get(leader) == term.incarnation
        yields = lives and self.order[leader] < self.order[self.agent]
        if self.ballot is not None and not yields:
            self._call(now)
        else:
            self._resign()
            self._review(now)

    def _on_call(self, caller: str, call: Call, now: int) -> None:
        if call.members.get(self.agent) != self.incarnation or call.term.leader != caller:
            return
        if call.term == self.term:
            self._send(caller, self._own())
            if "call" in self.timers:
                del self.timers["call"]
                self._review(now)
        elif self._prevails(caller):
            if call.term > self.term:
                self.heard = max(self.heard, call.term.number)
                self._call(now)
        elif self._bound(caller):
            pass
        elif call.term.number <= self.term.number:
            self._send(caller, Stale(self.term))
        else:
            self._enter(call.term)
            self.sound = True
            self.members_now = tuple(call.members)
            self._send(caller, self._own())
            self.timers["retry"] = now + self.retry
            self._review(now)

    def _on_joined(self, sender: str, message: Joined, now: int) -> None:
        if self.ballot is None or sender in self.ballot.joined or sender not in self.ballot.invited:
            return
        self.ballot.joined[sender] = message
        if self.begun:
            self._announce(now)
        else:
            self._count(now)

    def _count(self, now: int) -> None:
        """Begin the term if enough have joined, once this agent's copy is where it goes on from."""
        assert self.ballot is not None
        if self.begun or not self.ballot.enough(self.majority):
            return
        source = self.ballot.source(self.agent, by_side=self.mode == "continue")
        if source != self.agent:
            if self.fetching != source:
                self.sound = self.sound and self.ballot.joined[source].lineage[-1] != self.history.position
                self._fetch(source, now)
            return
        self._stop()
        self.sound = True
        self.applied = {self.agent: self.step}
        self.timers.pop("patience", None)
        self._place()
        self._announce(now)
        if self.event_driven:
            self.timers["close"] = now + self.deadline
        self._offer(now)

    def _recount(self, now: int) -> None:
        assert self.ballot is not None
        self.ballot.joined[self.agent] = self._own()
        self._count(now)

    def _announce(self, now: int) -> None:
        """Tell that the term has begun, or whom it has more."""
        assert self.ballot is not None
        self.members_now = tuple(agent for agent in self.agents if agent in self.ballot.joined)
        if len(self.members_now) > 1:
            self._send(None, self._begin())
            self.timers["retry"] = now + self.retry
