"""One agent's part in the agreement: a state machine with a step function for each role; those who are led have one.

An event (a message, a proposal, a timer, a change of the agents that are live) goes in, and the messages that it makes
this agent send come out. `Agreement.receive` chooses the function by `State.role`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from mdm.errors import ConfigError
from mdm.team.agreement.messages import (
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
    Position,
    Send,
    Snapshot,
    Stale,
    Term,
    contains,
)
from mdm.team.agreement.proposals import BARS, STOP, Asked, Held, Hold, Proposals
from mdm.team.agreement.state import Ballot, Log, State

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.team.agreement.messages import Message

TOGETHER = 64
"""Commits in one message to an agent that missed them."""

_INSISTS = 4
"""Messages one after the other by which a member says that it is ahead of its leader."""

Standing = Literal["leading", "following", "joining", "waiting"]
"""A role as statistics report it: ``joining`` until a term begins, ``waiting`` without a majority."""


class Replica(Protocol):
    """The copy that commits are applied to."""

    @property
    def running(self) -> bool:
        """Whether it decides."""

    def apply(self, commit: Commit) -> None:
        """Apply a step."""

    def digest(self) -> str:
        """Return a hash of all that determines the effect of further steps."""

    def snapshot(self) -> bytes:
        """Return the whole copy."""

    def restore(self, snapshot: bytes) -> None:
        """Become the copy that a snapshot is of."""


class Agreement:
    """One agent's part in the agreement of a team.

    Each event returns the messages to send. Any of them may be lost, late, repeated or overtaken. Messages are for
    live agents alone: those that this agent hears, and that hear it.

    Args:
        agent: This agent.
        agents: All agents of the team in their order, the same at every agent: the first of the live ones leads.
        replica: The copy that steps are applied to.
        incarnation: Which life of this agent; never the same again.
        mode: Without a majority of the agents, stop (``"majority"``) or go on alone (``"continue"``).
        event_driven: Whether a step is made when somebody sees something, or at each tick from all components.
        deadline_ns: How long a step waits for missing components, and for acknowledgements of the last step.
        retry_ns: After how long without an answer a message is sent again.
        patience_ns: How long a new term waits for live agents that do not answer; by default eight times ``retry_ns``.
        log_size: How many steps are kept for agents that missed some.

    Attributes:
        state: Where this agent stands.
        log: The steps that it has applied.
        proposals: Its own components and commands that no step has taken yet.
        hold: Whether it carries out no decisions, since it was stopped.
        reports: Events for a person, as pairs of a kind and a sentence; for the caller to take.
        late: Components and messages of older terms and steps that were dropped.
    """

    def __init__(
        self,
        agent: str,
        agents: Sequence[str],
        replica: Replica,
        *,
        incarnation: int,
        mode: Literal["majority", "continue"] = "majority",
        event_driven: bool,
        deadline_ns: int,
        retry_ns: int,
        patience_ns: int | None = None,
        log_size: int = 256,
    ) -> None:
        if agent not in agents:
            raise ConfigError(f"the team has no agent {agent!r}; its agents are {', '.join(agents)}")
        self.agent, self.agents, self.incarnation = agent, tuple(agents), incarnation
        self.replica = replica
        self.mode, self.event_driven = mode, event_driven
        self.majority = len(agents) // 2 + 1 if mode == "majority" else 1
        self.deadline, self.retry = deadline_ns, retry_ns
        self.patience = 8 * retry_ns if patience_ns is None else patience_ns
        self.order = {name: index for index, name in enumerate(agents)}
        self.state = State()
        self.log = Log(log_size, len(agents))
        self.proposals = Proposals(agent, event_driven=event_driven)
        self.hold = Hold(agent)
        self.asked = 0
        self.reports: list[tuple[str, str]] = []
        self.late = 0
        self._out: list[Send] = []

    # -- Where it stands -----------------------------------------------------------------------------------------

    @property
    def term(self) -> Term:
        """The term that this agent takes part in, or was called to last."""
        return self.state.term

    @property
    def step(self) -> int:
        """The last step that was applied."""
        return self.log.position.step

    @property
    def leader(self) -> str | None:
        """Who leads the present term, once it has begun."""
        return self.state.term.leader if self.state.begun else None

    @property
    def role(self) -> Standing:
        """The role of this agent as statistics report it: whether it takes part, is about to, or sees no majority."""
        state, ballot = self.state, self.state.ballot
        if state.role in {"leading", "following"}:
            return state.role
        stuck = ballot is not None and not ballot.patient and len(ballot.joined) < self.majority
        return "waiting" if stuck or len(state.live) < self.majority else "joining"

    @property
    def next_time(self) -> int | None:
        """When `tick` is wanted, in the nanoseconds of the caller's clock; None where no timer is set."""
        return min(self.state.timers.values()) if self.state.timers else None

    # -- Events --------------------------------------------------------------------------------------------------

    def members(self, live: Mapping[str, int], now: int, *, barred: bool = False) -> list[Send]:
        """Take note of the live agents, by incarnation, this one included; one that is barred takes part in no term."""
        self.state.barred = barred
        live = {**live, self.agent: self.incarnation}
        self.state.live = {agent: live[agent] for agent in self.agents if agent in live}
        self._review(now)
        return self._flush()

    def propose(
        self, component: bytes | None, now: int, command: str | None = None, token: str | None = None
    ) -> list[Send]:
        """Propose this agent's component of the next step; None: it saw nothing. A command makes a step of its own.

        Args:
            component: The component, encoded.
            now: The time.
            command: The command that it was asked for; a stop holds for this agent at once.
            token: The command's identifier, the same at all agents that are asked for the same; by default a new one.
        """
        asked = None
        if command is not None:
            self.asked += 1
            token = token or f"{self.agent}.{self.incarnation:x}.{self.asked}"
            asked = Asked(command, token, self.state.term)
            if command == STOP:
                self.hold.stop(token)
        self.proposals.add(component, asked)
        self._advance(now)
        out, self._out = self._out, []
        return out

    def receive(self, sender: str, incarnation: int, message: Message, now: int) -> list[Send]:
        """Take a message of another agent."""
        state, term = self.state, message.term
        if state.live.get(sender) != incarnation or sender == self.agent:
            self.late += 1
        elif isinstance(message, Call):
            self._receive_call(sender, message, now)
        elif term == state.term:
            if state.role == "leading":
                self._step_leading(sender, message, now)
            elif state.role == "calling":
                self._step_calling(sender, message, now)
            else:
                self._step_led(sender, message, now)
        elif isinstance(message, Stale) or (term > state.term and sender == term.leader):
            self._hear_of(term, now)
        else:
            # Of an older term: answer a sender that takes part in that with the present one.
            self.late += 1
            if isinstance(message, Begin | Commit | Component | Command | Applied):
                self._send(sender, Stale(self.state.term))
        out, self._out = self._out, []
        return out

    def tick(self, now: int) -> list[Send]:
        """Fire the timers that are due."""
        timers = self.state.timers
        for name in [name for name, time in timers.items() if time <= now]:
            if timers.get(name, now + 1) <= now:
                self.fire(name, now)
        return self._flush()

    def fire(self, timer: str, now: int) -> None:
        """Fire one timer."""
        state = self.state
        del state.timers[timer]
        if timer == "retry":
            self._retry(now)
        elif timer == "close":
            state.overdue = True
            self._advance(now)
        elif timer == "invite":
            self._call_again(now)
        elif timer == "call":
            self._call(now)
        elif timer == "patience" and state.ballot is not None:
            state.ballot.patient = False
            self._begin_if_enough(now)

    def _flush(self) -> list[Send]:
        out, self._out = self._out, []
        return out

    def _send(self, to: str | None, message: Message) -> None:
        self._out.append(Send(to, message))

    def _report(self, kind: str, text: str) -> None:
        self.reports.append((kind, text))

    # -- The step functions of roles -----------------------------------------------------------------------------

    def _step_leading(self, sender: str, message: Message, now: int) -> None:
        """Collect proposals and acknowledgements, send missing steps, and commit the next step when it is ready."""
        assert self.state.ballot is not None
        joined = self.state.ballot.joined
        match message:
            case Component() | Command():
                if sender in joined and self._counts(sender, message.step, now):
                    self._collect(sender, message)
                self._advance(now)
            case Applied():
                if sender in joined and not self._is_ahead(sender, message.step, now):
                    applied = self.state.applied
                    applied[sender] = max(applied.get(sender, 0), message.step)
                    self._advance(now)
            case Fetch(digest=None):
                self._send_missing(sender, message, whole=sender in joined)
            case Fetch():
                if sender in joined and self._outvotes(sender, message, now):
                    self._send(sender, self._snapshot())
            case Joined() if self._is_new(sender):
                joined[sender] = message
                self._announce(now)

    def _step_led(self, sender: str, message: Message, now: int) -> None:
        """Follow the leader: apply its commits and acknowledge them, and fetch missing steps.

        An agent that is joining first comes to where the leader begins, and only the leader may fetch steps from it.
        """
        state = self.state
        leads = sender == state.term.leader
        match message:
            case Commit() if leads and state.sound:
                self._receive_commit(message, now)
            case Begin() if leads:
                state.members = message.members
                if state.sound:
                    self._receive_begin(message, now)
            case Ended() if leads:
                state.suspend()
                state.released = True
                self._review(now)
            case Fetch(digest=None) if leads or state.role == "following":
                self._send_missing(sender, message, whole=leads)
            case Fetch() if leads:
                self._send(sender, self._snapshot())
            case Entries() if state.fetching is not None and state.sound:
                self._receive_entries(message, now)
            case Snapshot() if sender == state.fetching and not self._is_late(message):
                if self._restore(sender, message):
                    self._catch_up(now)

    def _step_calling(self, sender: str, message: Message, now: int) -> None:
        """Count the agents that join, and take the history that the term goes on from, until the term can begin."""
        state = self.state
        match message:
            case Joined() if self._is_new(sender):
                self._ballot.joined[sender] = message
                self._begin_if_enough(now)
            case Entries() if sender == state.fetching and state.sound:
                if self._apply_all(message, now):
                    state.fetching = None
                    joined = self._ballot.joined.get(sender)
                    if not (message.commits or joined is None or contains(self.log.lineage, joined.lineage[-1])):
                        self._call(now)  # it has not the history that it joined with: call all again
                    else:
                        self._join_own(now)
            case Snapshot() if sender == state.fetching:
                if self._restore(sender, message):
                    self._join_own(now)

    # -- Proposals, and the leader's commits ---------------------------------------------------------------------

    def _advance(self, now: int) -> None:
        """Send the pending proposals for the next step; as a leader, commit the steps that are ready."""
        state, proposals, hold = self.state, self.proposals, self.hold
        while (role := state.role) == "leading" or role == "following":
            step = self.log.position.step + 1
            if hold.held is not Held.ACTING and hold.waits and not proposals.holds(hold.waits):
                proposals.hold(hold.waits, state.term)
            if proposals.commands and proposals.commanded is None:
                proposals.commanded = (state.term, step)
                self._submit(self._command(step), now)
            if proposals.components and proposals.offered is None:
                proposals.offered = (state.term, step)
                self._submit(Component(state.term, step, proposals.components[0]), now)
            if role == "following" or not (state.components or state.commands) or not self._is_ready():
                return
            self._commit(now)

    def _submit(self, message: Component | Command, now: int) -> None:
        """Send a proposal to the leader; a leader collects its own."""
        state = self.state
        if state.role != "leading":
            self._send(state.term.leader, message)
            state.timers["retry"] = now + self.retry
            return
        self._collect(self.agent, message)
        self._set_deadline(now)

    def _command(self, step: int) -> Command:
        asked = self.proposals.commands[0]
        return Command(self.state.term, step, asked.command, asked.token)

    def _collect(self, sender: str, message: Component | Command) -> None:
        """Keep a proposal for the next step: the first component of each agent, and its first command or its stop."""
        if isinstance(message, Component):
            self.state.components.setdefault(sender, message.body)
        elif sender not in self.state.commands or message.command in BARS:
            self.state.commands[sender] = message.command, message.token

    def _set_deadline(self, now: int) -> None:
        """Limit how long the next step waits for others."""
        if not self.state.overdue:
            self.state.timers.setdefault("close", now + self.deadline)

    def _counts(self, sender: str, step: int, now: int) -> bool:
        """Return whether a member's proposal is for the next step; its sender has applied the step before its own."""
        if self._is_ahead(sender, step - 1, now):
            return False
        applied = self.state.applied
        applied[sender] = max(applied.get(sender, 0), step - 1)
        if step != self.log.position.step + 1:
            self.late += 1
            return False
        self._set_deadline(now)
        return True

    def _is_ahead(self, sender: str, step: int, now: int) -> bool:
        """Return whether a member says that it has more than its leader; where it goes on so, call a new term.

        No member has. Either another has spoken in its name, or it took another history than this one for its leader's,
        and would take no further step.
        """
        ahead = self.state.ahead
        if step <= self.log.position.step:
            if ahead:
                ahead.pop(sender, None)
            return False
        ahead[sender] = ahead.get(sender, 0) + 1
        if ahead[sender] >= _INSISTS:
            told = f"{sender} says that it has applied step {step}, and {self.agent}, which leads, {self.step}"
            self._report("history", f"{told}: all say again what they have")
            self._call(now)
        return True

    def _is_ready(self) -> bool:
        """Return whether the next step, for which something was proposed, can be committed.

        A majority has applied the last one, and no present member is awaited, or the deadline is over.
        """
        state = self.state
        components, commands = state.components, state.commands
        step, applied = self.log.position.step, state.applied
        if list(applied.values()).count(step) < self.majority:
            return False
        if state.overdue:
            return True
        members, live = state.members, state.live
        if commands or self.event_driven:
            awaited = [agent for agent in members if agent in live and applied.get(agent) != step]
        else:
            awaited = [agent for agent in members if agent in live and agent not in components]
        return not awaited

    def _commit(self, now: int) -> None:
        """Make the next step, apply it, and send it to all members."""
        state, last = self.state, self.log.position
        components, commands, applied = state.components, state.commands, state.applied
        inputs: dict[str, bytes] = {}
        missing: list[str] = []
        command, by, token = None, "", ""
        if commands:
            by = min(commands, key=lambda agent: commands[agent][0] not in BARS)  # of equals the first
            command, token = commands[by]
        else:
            for agent in self.agents:
                if (body := components.get(agent)) is not None:
                    inputs[agent] = body
                if applied.get(agent) != last.step if self.event_driven else agent not in components:
                    missing.append(agent)
        digest = self.replica.digest()
        commit = Commit(state.term, last.step + 1, last.term, inputs, tuple(missing), command, by, digest, token)
        self._apply(commit)
        applied[self.agent] = commit.step
        state.components, state.commands, state.overdue = {}, {}, False
        state.timers.pop("close", None)
        if self.event_driven:
            state.timers["close"] = now + self.deadline
        if len(state.members) > 1:
            self._send(None, commit)
            state.timers["retry"] = now + self.retry

    # -- Applying and acknowledging ------------------------------------------------------------------------------

    def _apply(self, commit: Commit) -> None:
        if commit.command is not None:
            self.hold.take(commit, Position(commit.term, commit.step))
        self.replica.apply(commit)
        self.log.append(commit)
        self.proposals.settle(commit)

    def _apply_checked(self, commit: Commit, now: int) -> bool:
        """Apply the next step, unless this agent's copy differs from the leader's."""
        digest = self.replica.digest()
        if commit.digest != digest:
            self._doubt(digest, now)
            return False
        self._apply(commit)
        return True

    def _apply_all(self, message: Entries, now: int) -> bool:
        """Apply the next steps among some; return False where this agent's copy differs."""
        for commit in message.commits:
            if self.log.follows(commit) and not self._apply_checked(commit, now):
                return False
        return True

    def _receive_commit(self, commit: Commit, now: int) -> None:
        """Apply the next step and acknowledge it; fetch the steps between."""
        state = self.state
        if not self.log.follows(commit):
            if state.role == "following" and commit.step <= self.step:
                self._send(state.term.leader, Applied(state.term, self.step))
            elif state.fetching is None:
                self._fetch(state.term.leader, now)
        elif self._apply_checked(commit, now):
            if state.role == "joining":
                self._take_part()
            state.fetching = None
            self._acknowledge(now, always=self.event_driven or commit.command is not None)

    def _acknowledge(self, now: int, *, always: bool = True) -> None:
        """Acknowledge the steps that were applied: by the next proposal, or else by a message of its own."""
        before = len(self._out)
        self._advance(now)
        if always and len(self._out) == before:
            self._send(self.state.term.leader, Applied(self.state.term, self.step))

    def _receive_begin(self, begin: Begin, now: int) -> None:
        """Follow the leader if this agent's copy equals the leader's; else fetch the missing steps, or a snapshot."""
        if self.state.role == "following" and begin.position.step <= self.step:
            self._send(self.state.term.leader, Applied(self.state.term, self.step))
        elif begin.position != self.log.position:
            if self.state.fetching is None:
                self._fetch(self.state.term.leader, now)
        elif begin.digest != (digest := self.replica.digest()):
            self._doubt(digest, now)
        else:
            self._take_part()
            self._acknowledge(now)

    def _take_part(self) -> None:
        """Take part in the steps of the term, whose history this agent's copy is in."""
        self.state.begin()
        self.proposals.renew(self.state.term)

    # -- Missing steps -------------------------------------------------------------------------------------------

    def _fetch(self, source: str, now: int) -> None:
        """Ask an agent for the steps after this one's last, or for a snapshot where this agent doubts its copy."""
        self.state.fetching = source
        self._send(source, self._request())
        self.state.timers["retry"] = now + self.retry

    def _request(self) -> Fetch:
        return Fetch(self.state.term, self.log.position, None if self.state.sound else self.replica.digest())

    def _doubt(self, digest: str, now: int) -> None:
        """Apply nothing more until another copy is taken, since this one differs."""
        source = self.state.fetching or self.state.term.leader
        self.state.suspend()
        self.state.sound = False
        self._report("digest", f"the copy of {self.agent} after step {self.step} is {digest}, another than at {source}")
        self._fetch(source, now)

    def _send_missing(self, to: str, message: Fetch, *, whole: bool) -> None:
        """Send the steps that an agent misses; where the log no longer has them, a snapshot, if it may be sent."""
        commits = self.log.since(message.position, TOGETHER)
        if commits is not None:
            self._send(to, Entries(self.state.term, commits))
        elif whole:
            self._send(to, self._snapshot())

    def _snapshot(self) -> Snapshot:
        log = self.log
        return Snapshot(self.state.term, log.lineage, log.side, self.replica.digest(), self.replica.snapshot())

    def _outvotes(self, sender: str, message: Fetch, now: int) -> bool:
        """Return whether the leader's copy counts against a member's that differs.

        It does once more than half of the members have applied a later step, and so have the same, or no other member
        is left to ask. Where more than half have another copy, the same among them, the leader takes theirs.
        """
        state, step, digest = self.state, message.position.step, message.digest
        assert digest is not None
        if self._is_ahead(sender, step, now):
            return False
        state.doubts[sender] = (step, digest)
        members = [agent for agent in state.members if agent in state.live]
        against = sum(1 for agent in members if state.doubts.get(agent) == (step, digest))
        if 2 * against > len(members):
            state.sound = False
            self._report("digest", f"the copy of {self.agent}, which leads, is not what most have after step {step}")
            self._call(now)
            return False
        agreeing = sum(1 for agent in members if state.applied.get(agent, 0) > step)
        doubting = sum(1 for agent in members if state.doubts.get(agent, (None,))[0] == step)
        return 2 * agreeing > len(members) or agreeing + doubting >= len(members)

    def _receive_entries(self, message: Entries, now: int) -> None:
        """Apply the steps that were fetched, and follow on from there."""
        if self._apply_all(message, now):
            self.state.fetching = None
            if len(message.commits) == TOGETHER:
                self._fetch(self.state.term.leader, now)
            else:
                self._catch_up(now)

    def _is_late(self, message: Snapshot) -> bool:
        """Return whether a snapshot is of an earlier step of a history that is that of the term already."""
        position = message.lineage[-1]
        placed = self.state.role == "following" or not self.state.sound
        return placed and position.step < self.step and contains(self.log.lineage, position)

    def _restore(self, sender: str, message: Snapshot) -> bool:
        """Become the copy of a snapshot; one whose digest is another is dropped."""
        before = self.replica.snapshot()
        self.replica.restore(message.body)
        position = message.lineage[-1]
        if self.replica.digest() != message.digest:
            self.replica.restore(before)
            self._report("digest", f"the snapshot of {sender} after step {position.step} is not what it should be")
            return False
        self.log.replace(message.lineage, message.side)
        self.hold.restore(message.lineage, running=self.replica.running)
        self.proposals.forget(position.step)
        self.state.sound = True
        self.state.fetching = None
        return True

    def _catch_up(self, now: int) -> None:
        """Take part again, with nothing missing, and acknowledge that."""
        if self.state.role == "joining":
            self._take_part()
        self._acknowledge(now)

    # -- Terms ---------------------------------------------------------------------------------------------------

    @property
    def _ballot(self) -> Ballot:
        """The answers to this agent's call, where it leads or calls."""
        assert self.state.ballot is not None
        return self.state.ballot

    def _review(self, now: int) -> None:
        """Call a new term, or give up the present one, where the agents that are live ask for it."""
        state = self.state
        if state.barred:
            state.resign()
            state.timers.clear()
            return
        if state.ballot is None and not state.led:
            state.suspend()
        if len(state.live) < self.majority:
            self._wait_for_majority(now)
            return
        state.quorate = True
        first = next(iter(state.live))
        if state.ballot is not None:
            wanted = state.ballot.invited != state.live
        else:
            wanted = state.role == "joining" or first == self.agent
        if not wanted:
            state.timers.pop("call", None)
        elif self.majority == 1 and state.term == START.term and len(state.live) < len(self.agents):
            state.timers.setdefault("call", now + self.patience)
        elif first == self.agent:
            self._call(now)
        else:
            state.timers.setdefault("call", now + self.patience * (1 + list(state.live).index(self.agent)))

    def _wait_for_majority(self, now: int) -> None:
        """Give up the present term, if this agent leads or calls it, since it sees no majority."""
        state = self.state
        state.timers.pop("call", None)
        if state.quorate:
            state.quorate = False
            seen = f"{len(state.live)} of {len(self.agents)} agents"
            self._report("majority", f"{self.agent} sees {seen} and waits for more")
        if state.ballot is not None:
            state.resign()
            self._send(None, Ended(state.term))
            state.timers["retry"] = now + self.retry

    def _enter(self, term: Term) -> None:
        """Leave all older terms for this one."""
        self.state.enter(term)

    def _call(self, now: int) -> None:
        """Call the agents that this one sees to a new term."""
        state = self.state
        self._enter(Term(max(state.highest, state.term.number) + 1, self.agent, self.incarnation))
        state.ballot = Ballot(state.live)
        state.ballot.joined[self.agent] = self._joined()
        state.role = "calling"
        state.timers["patience"] = now + self.patience
        if len(state.live) > 1:
            state.timers["invite"] = now + self.retry
            self._send(None, self._invitation())
        self._begin_if_enough(now)

    def _invitation(self) -> Call:
        return Call(self.state.term, self._ballot.invited)

    def _joined(self) -> Joined:
        return Joined(self.state.term, self.log.lineage, self.log.side, self.replica.digest(), self.state.sound)

    def _call_again(self, now: int) -> None:
        """Call those again who have not joined."""
        absent = [agent for agent in self._ballot.invited if agent not in self._ballot.joined]
        for agent in absent:
            self._send(agent, self._invitation())
        if absent:
            self.state.timers["invite"] = now + self.retry

    def _is_bound(self, caller: str) -> bool:
        """Return whether this agent stays with the leader that it has, which comes before the caller."""
        state, leader = self.state, self.state.term.leader
        if leader == self.agent or state.released or not state.led:
            return False
        return self.order[leader] < self.order[caller]

    def _outranks(self, caller: str) -> bool:
        """Return whether it is on this agent to call, and not on the caller."""
        state = self.state
        calls = state.ballot is not None or next(iter(state.live), None) == self.agent
        return calls and len(state.live) >= self.majority and self.order[self.agent] < self.order[caller]

    def _is_mine(self) -> bool:
        """Return whether this agent called the present term, in this life."""
        return self.state.term.leader == self.agent and self.state.term.incarnation == self.incarnation

    def _is_new(self, sender: str) -> bool:
        """Return whether an agent was called that has not joined yet."""
        return sender in self._ballot.invited and sender not in self._ballot.joined

    def _hear_of(self, term: Term, now: int) -> None:
        """Take note of a newer term, from its leader or from one that joined it: apply no more in this one."""
        state, leader = self.state, term.leader
        if term.number < state.term.number or term == state.term or leader not in self.order or self._is_bound(leader):
            return
        state.highest = max(state.highest, term.number)
        lives = state.live.get(leader) == term.incarnation
        yields = lives and self.order[leader] < self.order[self.agent]
        if state.ballot is not None and not yields:
            self._call(now)
        else:
            state.resign()
            self._review(now)

    def _receive_call(self, caller: str, call: Call, now: int) -> None:
        """Join the term of a caller, unless this agent is bound to another leader or is to call itself."""
        state = self.state
        if call.members.get(self.agent) != self.incarnation or call.term.leader != caller:
            return
        if call.term == state.term:
            self._send(caller, self._joined())
            if "call" in state.timers:
                del state.timers["call"]
                self._review(now)
        elif self._outranks(caller):
            if call.term > state.term:
                state.highest = max(state.highest, call.term.number)
                self._call(now)
        elif self._is_bound(caller):
            pass
        elif call.term.number <= state.term.number:
            self._send(caller, Stale(state.term))
        else:
            self._enter(call.term)
            state.sound = True
            state.members = tuple(call.members)
            self._send(caller, self._joined())
            state.timers["retry"] = now + self.retry
            self._review(now)

    def _begin_if_enough(self, now: int) -> None:
        """Begin the term if enough have joined, once this agent's copy is where it goes on from."""
        state, ballot = self.state, self._ballot
        if state.role == "leading" or not ballot.enough(self.majority):
            return
        source = ballot.source(self.agent, by_side=self.mode == "continue")
        if source != self.agent:
            if state.fetching != source:
                state.sound = state.sound and ballot.joined[source].lineage[-1] != self.log.position
                self._fetch(source, now)
            return
        state.suspend()
        state.sound = True
        state.applied = {self.agent: self.step}
        state.timers.pop("patience", None)
        self._take_part()
        self._announce(now)
        if self.event_driven:
            state.timers["close"] = now + self.deadline
        self._advance(now)

    def _join_own(self, now: int) -> None:
        """Answer its own call again, after this agent has taken the missing steps."""
        self._ballot.joined[self.agent] = self._joined()
        self._begin_if_enough(now)

    def _announce(self, now: int) -> None:
        """Send where the term begins, and who takes part in it."""
        state = self.state
        state.members = tuple(agent for agent in self.agents if agent in self._ballot.joined)
        if len(state.members) > 1:
            self._send(None, self._begin())
            state.timers["retry"] = now + self.retry

    def _begin(self) -> Begin:
        return Begin(self.state.term, self.log.position, self.replica.digest(), self.state.members)

    # -- Sending again -------------------------------------------------------------------------------------------

    def _retry(self, now: int) -> None:
        """Send unanswered messages again."""
        state, before = self.state, len(self._out)
        if len(state.live) < self.majority and self._is_mine():
            self._send(None, Ended(state.term))
        elif state.fetching is not None:
            self._send(state.fetching if state.ballot is not None or not state.sound else None, self._request())
            if state.ballot is not None:
                self._send(None, self._invitation())  # those who wait for this copy know that its agent lives
        elif state.role == "leading":
            self._retry_last_step()
        elif state.role == "following":
            proposals, leader = self.proposals, self.state.term.leader
            if proposals.commanded is not None:
                self._send(leader, self._command(proposals.commanded[1]))
            if proposals.offered is not None:
                self._send(leader, Component(*proposals.offered, proposals.components[0]))
        elif state.role == "joining" and state.led and not state.released:
            self._send(state.term.leader, self._joined())
        if len(self._out) > before:
            state.timers["retry"] = now + self.retry

    def _retry_last_step(self) -> None:
        """Send the last step to members that are not known to have applied it; where that is no help, the beginning."""
        state, step, commits = self.state, self.step, self.log.commits
        for agent in state.members:
            applied = state.applied.get(agent)
            if applied == step or agent not in state.live:
                continue
            last = commits[-1] if applied == step - 1 and commits else None
            self._send(agent, self._begin() if last is None or last.term != state.term else last)
