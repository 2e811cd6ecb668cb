"""The state of one agent in the agreement: its role, its term, the steps that it has applied, and who else has."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal

import msgspec

from mdm.team.agreement.messages import START, Commit, Position, Term, contains

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.team.agreement.messages import Joined

TERMS = 16
"""Terms of which a lineage keeps the last step. An agent that left before the oldest of them takes a snapshot."""

Role = Literal["leading", "calling", "following", "joining"]
"""How an agent handles a message.

- ``leading``: it commits the steps of a term that it called.
- ``calling``: it has called a term, which has not begun.
- ``following``: it applies the steps that the leader of its term commits.
- ``joining``: it applies no step of its term, since that has not begun, or its copy is elsewhere.
"""


class Log:
    """The steps that were applied, in order.

    A step is known by its term and number: two histories with the same step are the same up to it, since each commit
    names the term of the step before. So a few numbers tell whether one history goes on from another.

    Args:
        size: How many commits are kept, at least.
        agents: How many agents the team has.

    Attributes:
        side: How many of them took part in the last step that was not a command.
        position: The last step that was applied.
    """

    def __init__(self, size: int, agents: int) -> None:
        self.size, self.agents = size, agents
        self.side = 0
        self.lineage: tuple[Position, ...] = (START,)
        self.position = START
        self.commits: list[Commit] = []

    def follows(self, commit: Commit) -> bool:
        """Return whether a commit is the next step of this history."""
        last = self.position
        return commit.step == last.step + 1 and commit.previous == last.term

    def append(self, commit: Commit) -> None:
        """Add the next step."""
        last = Position(commit.term, commit.step)
        if commit.term == self.position.term:
            self.lineage = (*self.lineage[:-1], last)
        else:
            self.lineage = (*self.lineage[1 - TERMS :], last)
        self.position = last
        if commit.command is None:
            self.side = self.agents - len(commit.missing)
        self.commits.append(commit)
        if len(self.commits) >= 2 * self.size:
            del self.commits[: -self.size]

    def replace(self, lineage: tuple[Position, ...], side: int) -> None:
        """Take another history, of which no commits are known."""
        self.lineage, self.position, self.side = lineage, lineage[-1], side
        self.commits = []

    def since(self, position: Position, limit: int) -> tuple[Commit, ...] | None:
        """Return the commits after a position, up to so many; None where they are not known."""
        if not contains(self.lineage, position):
            return None
        held = len(self.commits) - (self.position.step - position.step)
        return tuple(self.commits[held : held + limit]) if held >= 0 else None


class Ballot:
    """The answers to a call.

    Args:
        invited: Who was called, with their incarnations.

    Attributes:
        joined: The answers by agent, the caller's own included.
        patient: Whether the caller still waits for all of them.
    """

    def __init__(self, invited: Mapping[str, int]) -> None:
        self.invited = dict(invited)
        self.joined: dict[str, Joined] = {}
        self.patient = True

    def enough(self, majority: int) -> bool:
        """Return whether the term may begin.

        It waits for all who were called, while the leader has patience. Without some of them it needs a majority that
        has not just been started: an agent that has lost its memory cannot vouch that nothing was decided.
        """
        if len(self.joined) < majority:
            return False
        if len(self.joined) == len(self.invited):
            return True
        if self.patient:
            return False
        remembering = sum(1 for joined in self.joined.values() if joined.lineage[-1] != START)
        return not remembering or remembering >= majority

    def source(self, leader: str, *, by_side: bool) -> str:
        """Return the agent whose history the term goes on from.

        It is the latest of those that no other goes on from; with ``by_side``, that of the larger side. Among equals
        the copy that most of them have counts, and the leader has it rather than another.
        """
        candidates = {agent: joined for agent, joined in self.joined.items() if joined.sound} or self.joined
        lineages = {joined.lineage for joined in candidates.values()}
        last = max(
            (joined.side if by_side else 0, joined.lineage[-1])
            for joined in candidates.values()
            if not any(
                contains(lineage, joined.lineage[-1]) and lineage[-1] != joined.lineage[-1] for lineage in lineages
            )
        )[1]
        equals = {agent: joined for agent, joined in candidates.items() if joined.lineage[-1] == last}
        copies = Counter(joined.digest for joined in equals.values())
        own = self.joined[leader]

        def weight(agent: str) -> tuple[int, bool, bool, str]:
            digest = equals[agent].digest
            return -copies[digest], digest != own.digest or leader not in equals, agent != leader, agent

        return min(equals, key=weight)


class State(msgspec.Struct):
    """Where one agent stands; `Agreement` alone changes it.

    Invariants, which hold between any two events:

    1. An agent that leads or calls does so in a term of its own, and has a ballot with its own answer in it. No other
       agent has a ballot.
    2. An agent calls and leads only while it sees a majority, and leads only where a majority has joined.
    3. An agent that follows sees the leader of its term, in the life that called the term, and is not that leader.
    4. An agent that leads or follows trusts its copy.
    5. An agent that leads fetches nothing; one that calls fetches from an agent that has joined.
    6. An agent that fetches will ask again: ``retry`` is set.
    7. ``close`` is set only where an agent leads, ``patience`` where it calls, ``invite`` where it does either.
    8. A leader has applied each step that it knows a member to have applied, and knows that of itself.
    9. No term is newer than the highest that was heard of.

    Attributes:
        role: Which step function takes the messages of the term.
        term: The term that the agent takes part in, or was called to last.
        highest: The highest number of a term that it has heard of.
        live: The agents that it sees, in the order of the team, by incarnation; itself included.
        barred: Whether it may take part in no term.
        quorate: Whether it saw a majority when it looked last.
        released: Whether the leader of the term has ended it.
        sound: Whether it has no reason to doubt its copy.
        fetching: The agent that it has asked for steps or a snapshot; None where it lacks nothing that it knows of.
        members: The agents that take part in the term, as far as the agent was told.
        ballot: The answers to its call, while it leads or calls.
        applied: By member the last step that it is known to have applied, at a leader.
        doubts: By member the step after which its copy differs, and its digest, at a leader.
        ahead: By member how often in a row it said that it has applied more than its leader.
        components: By member its component of the next step, at a leader.
        commands: By member the command that it proposes for the next step, and its token, at a leader.
        overdue: Whether the next step has waited for its deadline.
        timers: When each timer that is set fires: ``retry``, ``close``, ``call``, ``invite`` and ``patience``.
    """

    role: Role = "joining"
    term: Term = START.term
    highest: int = 0
    live: dict[str, int] = {}
    barred: bool = False
    quorate: bool = False
    released: bool = False
    sound: bool = True
    fetching: str | None = None
    members: tuple[str, ...] = ()
    ballot: Ballot | None = None
    applied: dict[str, int] = {}
    doubts: dict[str, tuple[int, str]] = {}
    ahead: dict[str, int] = {}
    components: dict[str, bytes | None] = {}
    commands: dict[str, tuple[str, str]] = {}
    overdue: bool = False
    timers: dict[str, int] = {}

    @property
    def begun(self) -> bool:
        """Whether the agent takes part in the steps of its term."""
        return self.role in {"leading", "following"}

    @property
    def led(self) -> bool:
        """Whether the agent sees the leader of its term."""
        return self.live.get(self.term.leader) == self.term.incarnation

    def enter(self, term: Term) -> None:
        """Leave all older terms for this one."""
        self.suspend()
        self.role, self.ballot = "joining", None
        self.term, self.highest = term, max(self.highest, term.number)
        self.released = False
        self.applied, self.doubts, self.ahead = {}, {}, {}
        self.components, self.commands, self.overdue = {}, {}, False
        for timer in ("call", "patience", "invite", "retry"):
            self.timers.pop(timer, None)

    def suspend(self) -> None:
        """Apply nothing more in this term, until it begins again here."""
        self.role = "joining" if self.ballot is None else "calling"
        self.fetching = None
        self.timers.pop("close", None)

    def resign(self) -> None:
        """Lead no more, and call no more."""
        self.ballot = None
        self.suspend()
        self.timers.pop("patience", None)
        self.timers.pop("invite", None)

    def begin(self) -> None:
        """Take part in the steps of the term, whose history this agent's copy is in."""
        self.role = "following" if self.ballot is None else "leading"
        self.fetching = None
        self.timers.pop("call", None)
