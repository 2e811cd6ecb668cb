"""Where an agent stands: its term, its history, what it waits for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from mdm.errors import ConfigError
from mdm.team.agreement.entries import START, Joined, Send
from mdm.team.agreement.history import History
from mdm.team.agreement.hold import Hold
from mdm.team.agreement.proposals import Proposals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.team.agreement.ballot import Ballot
    from mdm.team.agreement.entries import Commit, Message, Term

__all__ = ["Replica", "Role", "Standing"]

Role = Literal["leading", "following", "joining", "waiting", "refused"]
"""Where an agent stands: ``joining`` until a term begins, ``waiting`` without a majority, ``refused`` for good."""


class Replica(Protocol):
    """The copy that commits are applied to."""

    @property
    def running(self) -> bool:
        """Whether it decides."""

    def apply(self, commit: Commit) -> None:
        """Apply a step."""

    def digest(self) -> str:
        """Return a hash of all that decides what further steps do."""

    def snapshot(self) -> bytes:
        """Return the whole copy."""

    def restore(self, snapshot: bytes) -> None:
        """Become the copy that a snapshot is of."""


class Standing:
    """Where one agent stands in the agreement of its team, and what it says; the base of `Agreement`."""

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
            raise ConfigError(f"{agent!r} is none of the team's agents {', '.join(agents)}")
        self.agent, self.agents, self.incarnation = agent, tuple(agents), incarnation
        self.replica = replica
        self.mode, self.event_driven = mode, event_driven
        self.majority = len(agents) // 2 + 1 if mode == "majority" else 1
        self.deadline, self.retry = deadline_ns, retry_ns
        self.patience = 8 * retry_ns if patience_ns is None else patience_ns
        self.order = {name: index for index, name in enumerate(agents)}

        self.term = START.term
        self.begun = False
        self.heard = 0
        self.live: dict[str, int] = {}
        self.present: dict[str, int] = {}
        self.barred = False
        self.enough = False
        self.released = False
        self.sound = True
        self.fetching: str | None = None
        self.ballot: Ballot | None = None
        self.members_now: tuple[str, ...] = ()
        self.history = History(log_size, len(agents))
        self.proposals = Proposals(agent, event_driven=event_driven)
        self.hold = Hold(agent)
        self.asked = 0
        self._new_step()
        self.applied: dict[str, int] = {}
        self.doubts: dict[str, tuple[int, str]] = {}
        self.ahead: dict[str, int] = {}

        self.timers: dict[str, int] = {}
        self.reports: list[tuple[str, str]] = []
        self.late = 0
        self._out: list[Send] = []

    @property
    def next_time(self) -> int | None:
        """When `tick` is wanted, in the nanoseconds of the caller's clock."""
        return min(self.timers.values()) if self.timers else None

    @property
    def step(self) -> int:
        """The last step that was applied."""
        return self.history.position.step

    @property
    def leader(self) -> str | None:
        """Who leads the present term, once it has begun."""
        return self.term.leader if self.begun else None

    @property
    def role(self) -> Role:
        """Where this agent stands."""
        if self.begun:
            return "leading" if self.ballot is not None else "following"
        stuck = self.ballot is not None and not self.ballot.patient and len(self.ballot.joined) < self.majority
        return "waiting" if stuck or len(self.present) < self.majority else "joining"

    def _sent(self) -> list[Send]:
        out, self._out = self._out, []
        return out

    def _send(self, to: str | None, message: Message) -> None:
        self._out.append(Send(to, message))

    def _report(self, kind: str, text: str) -> None:
        self.reports.append((kind, text))

    def _is_mine(self) -> bool:
        return self.term.leader == self.agent and self.term.incarnation == self.incarnation

    def _is_led(self, agent: str) -> bool:
        return self.begun and self.ballot is not None and agent in self.ballot.joined

    def _own(self) -> Joined:
        return Joined(self.term, self.history.lineage, self.history.side, self.replica.digest(), self.sound)

    def _enter(self, term: Term) -> None:
        """Leave all older terms for this one."""
        self._stop()
        self.term = term
        self.heard = max(self.heard, term.number)
        self.ballot = None
        self.released = False
        self.applied, self.doubts, self.ahead = {}, {}, {}
        self._new_step()
        for timer in ("call", "patience", "invite", "retry"):
            self.timers.pop(timer, None)

    def _place(self) -> None:
        """Take part in the steps of the term, whose history this agent's copy is in."""
        self.begun = True
        self.fetching = None
        self.timers.pop("call", None)
        self.proposals.renew(self.term)

    def _stop(self) -> None:
        """Apply nothing more in this term."""
        self.begun = False
        self.fetching = None
        self.timers.pop("close", None)

    def _new_step(self) -> None:
        self.components: dict[str, bytes | None] = {}
        self.commands: dict[str, tuple[str, str]] = {}
        self.overdue = False
