"""One agent's part in the agreement: what takes each message, each timer, and each change of who is live."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.team.agreement.entries import (
    START,
    Applied,
    Begin,
    Call,
    Command,
    Commit,
    Component,
    Ended,
    Entries,
    Fetch,
    Joined,
    Snapshot,
    Stale,
    positions,
)
from mdm.team.agreement.hold import STOP
from mdm.team.agreement.proposals import Asked
from mdm.team.agreement.recovery import Recovery
from mdm.team.transport.bounds import can_be

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.team.agreement.entries import Message, Send

__all__ = ["Agreement"]

_STEP = 1000
"""Nanoseconds that a step takes at least."""


class Agreement(Recovery):
    """One agent's part in the agreement of a team.

    Each event returns the messages to send. Any of them may be lost, late, repeated or overtaken. Messages are for
    live agents alone: those that this agent hears, and that hear it.

    Args:
        agent: This agent.
        agents: All agents of the team in their order, the same at every agent: the first of the live ones leads.
        replica: What steps are applied to.
        incarnation: Which life of this agent; never the same again.
        mode: Without a majority of the agents, stop (``"majority"``) or go on alone (``"continue"``).
        event_driven: Whether a step is made when somebody sees something, or at each tick from all components.
        deadline_ns: How long a step waits for those whose component, or word that they applied the last step, is due.
        retry_ns: After how long without an answer a message is sent again.
        patience_ns: How long a new term waits for live agents that do not answer; by default eight times ``retry_ns``.
        log_size: How many steps are kept for those who missed some.

    Attributes:
        next_time: When `tick` is wanted, or None.
        members_now: Who takes part in the present term.
        reports: What happened that a person should know, as pairs of a kind and a sentence; for the caller to take.
        late: Components and messages of older terms and steps that were dropped.
    """

    def members(self, live: Mapping[str, int], now: int, *, barred: bool = False) -> list[Send]:
        """Take note of who is live, by incarnation, this agent included; one that is barred takes part in no term."""
        self.barred = barred
        live = {**live, self.agent: self.incarnation}
        self.live = {agent: live[agent] for agent in self.agents if agent in live}
        self._review(now)
        return self._sent()

    def propose(
        self, component: bytes | None, now: int, command: str | None = None, token: str | None = None
    ) -> list[Send]:
        """Propose what this agent saw, for the next step; None: it saw nothing. A command makes a step of its own.

        Args:
            component: What it saw.
            now: The time.
            command: What it was asked for; a stop holds for this agent at once.
            token: What the command is known by, the same at all agents that are asked for the same; by default its own.
        """
        asked = None
        if command is not None:
            self.asked += 1
            token = token or f"{self.agent}.{self.incarnation:x}.{self.asked}"
            asked = Asked(command, token, self.term)
            if command == STOP:
                self.hold.stop(token)
        self.proposals.add(component, asked)
        self._offer(now)
        return self._sent()

    def believes(self, message: Message, now: int) -> bool:
        """Return whether the terms and steps of a message can be such, by this agent's clock and for this team."""
        term = message.term
        if not (term.leader in self.order or term == START.term) or not can_be(term.number, now):
            return False
        step = getattr(message, "step", None)
        if step is not None:
            return can_be(step, now, _STEP)
        return all(at.term.number <= term.number and can_be(at.step, now, _STEP) for at in positions(message))

    def receive(self, sender: str, incarnation: int, message: Message, now: int) -> list[Send]:
        """Take a message of another agent."""
        term = message.term
        if self.live.get(sender) != incarnation or sender == self.agent:
            self.late += 1
        elif term == self.term and (handler := OF_TERM.get(type(message))) is not None:
            if sender == term.leader or type(message) not in OF_LEADER:
                getattr(self, handler)(sender, message, now)
        elif isinstance(message, Call):
            self._on_call(sender, message, now)
        elif isinstance(message, Stale) or (term > self.term and sender == term.leader):
            self._newer(term, now)
        else:
            self._on_older(sender, message)
        return self._sent()

    def tick(self, now: int) -> list[Send]:
        """Do what is due."""
        for name in [name for name, time in self.timers.items() if time <= now]:
            if self.timers.get(name, now + 1) <= now:
                self.fire(name, now)
        return self._sent()

    def fire(self, name: str, now: int) -> None:
        """Do what one timer asks for."""
        del self.timers[name]
        if name == "retry":
            self._repeat(now)
        elif name == "close":
            self.overdue = True
            self._offer(now)
        elif name == "invite":
            self._invite(now)
        elif name == "call":
            self._call(now)
        elif name == "patience" and self.ballot is not None:
            self.ballot.patient = False
            self._count(now)

    def _on_older(self, sender: str, message: Message) -> None:
        """Drop what is of an older term, and tell who should know of this one."""
        self.late += 1
        if isinstance(message, Begin | Commit | Component | Command | Applied):
            self._send(sender, Stale(self.term))

    def _on_ended(self, _sender: str, _message: Ended, now: int) -> None:
        self._stop()
        self.released = True
        self._review(now)

    def _repeat(self, now: int) -> None:
        """Say again what was not answered."""
        said = len(self._out)
        if len(self.present) < self.majority and self._is_mine():
            self._send(None, Ended(self.term))
        elif self.fetching is not None:
            self._send(self.fetching if self.ballot is not None or not self.sound else None, self._request())
            if self.ballot is not None:
                self._send(None, self._invitation())  # those who wait for this copy know that its agent lives
        elif self.ballot is not None:
            if self.begun:
                self._remind()
        elif self.begun:
            self._insist()
        elif self.present.get(self.term.leader) == self.term.incarnation and not self.released:
            self._send(self.term.leader, self._own())
        if len(self._out) > said:
            self.timers["retry"] = now + self.retry


OF_TERM: dict[type, str] = {
    Component: "_on_component",
    Commit: "_on_commit",
    Applied: "_on_applied",
    Command: "_on_command",
    Joined: "_on_joined",
    Fetch: "_on_fetch",
    Entries: "_on_entries",
    Snapshot: "_on_snapshot",
    Begin: "_on_begin",
    Ended: "_on_ended",
}
"""What takes each message of the present term."""

OF_LEADER = {Commit, Begin, Ended}
"""Messages that the leader of a term alone may send."""
