"""An agent's proposals for the next steps: its components and commands, pending until a step has taken them."""

from __future__ import annotations

from collections import deque
from enum import Enum
from typing import TYPE_CHECKING

import msgspec

from mdm.team.agreement.messages import Position, Term, contains
from mdm.team.transport.bounds import Name

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.team.agreement.messages import Commit, Lineage

STOP = "stop"

HOLD = "hold"
"""The command by which an agent says that it stays stopped: nobody else stops, and a start of the team from then on
was asked for by an agent that knows of it."""

BARS = frozenset({STOP, HOLD})
"""Commands that beat each start that was asked for before them."""

STARTS = frozenset({"start", "resume", "begin"})
"""Commands after which a team decides; the last is the team's own, and ends no hold."""

OPENS = STARTS | {"reset"}
"""Commands that a stop beats."""

WAITING = 64
"""Components that happen before a step can take them, in event-driven teams; the oldest is lost beyond."""

COMMANDS = 16
"""Commands that wait."""


class Asked(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A command that was asked for at this agent.

    Args:
        command: ``"start"``, ``"stop"``, ``"reset"``…
        token: Its identifier, the same at each agent that was asked for it.
        term: The term in which it was asked for.
    """

    command: str
    token: str
    term: Term


class Proposals:
    """An agent's own components and commands, in their order.

    A component that was offered for a step counts for that step alone. Where the step went without it, an event is
    offered again for the next one, and a reading of a fixed rate is dropped, since the next is on its way. Where a
    command became the step, which takes no components, both are offered again.

    A command counts in the term in which it was asked for. A stop beats a start or reset that was asked for before it,
    here at once, elsewhere when it is applied there.

    Attributes:
        void: Commands that will be no step, each with the reason; for the caller to take.
    """

    def __init__(self, agent: str, *, event_driven: bool) -> None:
        self.agent = agent
        self.event_driven = event_driven
        self.components: deque[bytes | None] = deque()
        self.commands: deque[Asked] = deque()
        self.offered: tuple[Term, int] | None = None
        self.commanded: tuple[Term, int] | None = None
        self.dropped = 0
        self.void: list[tuple[Asked, str]] = []

    def add(self, component: bytes | None, asked: Asked | None) -> None:
        """Add a component, a command, or both."""
        if asked is not None:
            self._ask(asked)
            if component is None:
                return
        if not self.event_driven:
            while len(self.components) > (self.offered is not None):
                self.components.pop()
                self.dropped += 1
            self.components.append(component)
        elif component is not None:
            if len(self.components) == WAITING:
                del self.components[1]
                self.dropped += 1
            self.components.append(component)

    def _ask(self, asked: Asked) -> None:
        commands = self.commands
        if asked.command == STOP:
            self._discard(lambda one: one.command in OPENS, "a stop was asked for after it")
        if len(commands) < COMMANDS:
            commands.append(asked)
        elif asked.command == STOP:
            self.dropped += 1
            commands[-1] = asked  # the later of two stops holds for both
        else:
            self.dropped += 1
            self.void.append((asked, f"{COMMANDS} commands wait before it"))

    def _discard(self, which: Callable[[Asked], bool], reason: str) -> None:
        """Drop commands, and keep for the caller why."""
        gone = [asked for asked in self.commands if which(asked)]
        if not gone:
            return
        if self.commands[0] in gone:
            self.commanded = None
        for asked in gone:
            self.commands.remove(asked)
        self.void += ((asked, reason) for asked in gone)

    def settle(self, commit: Commit) -> None:
        """Take note of a step that was applied."""
        if commit.command is not None:
            self._settle_command(commit)
        elif self.offered == (commit.term, commit.step) and self.components:
            taken = self.agent in commit.inputs or self.components[0] is None
            if taken or not self.event_driven:
                self.components.popleft()
                self.dropped += not taken
        self.offered = self.commanded = None

    def _settle_command(self, commit: Commit) -> None:
        commands, after = self.commands, False
        for place, asked in enumerate(commands):
            own = commit.by == self.agent
            same = (asked.token, asked.command) == (commit.token, commit.command)
            if same and (own or (place == 0 and asked.command in OPENS)):
                del commands[place]  # it is a step now: by this agent, or by another that was asked for the same
                after = own
                break
        if commit.command in BARS and not after:
            reason = f"a {commit.command} of {commit.by} came before it"
            self._discard(lambda one: one.command in OPENS, reason)

    def renew(self, term: Term) -> None:
        """Take note of a new term, in which nothing was offered yet; older components and commands are too old."""
        if not self.event_driven:
            self.dropped += len(self.components)
            self.components.clear()
        self._discard(lambda one: one.term != term, "the term in which it was asked for has ended")
        self.offered = self.commanded = None

    def forget(self, step: int) -> None:
        """Take note of a snapshot, which holds all steps up to one; a component that was offered until then is past."""
        if self.offered is not None and self.offered[1] <= step:
            self.components.popleft()
        self._discard(lambda one: one.command in OPENS, "steps that this agent does not know may have stopped the team")
        self.offered = self.commanded = None

    def holds(self, token: str) -> bool:
        """Return whether a stop, or a hold in its place, waits to be a step."""
        return any(asked.token == token and asked.command in BARS for asked in self.commands)

    def hold(self, token: str, term: Term) -> None:
        """Put a hold before the other commands of this agent."""
        self.commands.appendleft(Asked(HOLD, token, term))
        self.commanded = None


class Standstill(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The last stop that an agent obeys, as it outlives the agent's process.

    Args:
        token: Its token.
        at: Where it stands in the history that the agent had; None where it is in none.
        kept: Whether the step there is a hold.
    """

    token: Name
    at: Position | None = None
    kept: bool = False


class Held(Enum):
    """How an agent obeys the last stop that it took, by where that stands in its history."""

    ACTING = "it carries out the decisions of its copy"
    ASKED = "the stop was asked of it, and is in no history of its own yet"
    STOPPED = "the stop is a step"
    KEPT = "a hold in place of the stop is a step, whatever the team does"
    RECALLED = "as STOPPED in an earlier process: its history has not come to that step yet"
    RECALLED_KEPT = "as KEPT in an earlier process: its history has not come to that step yet"


_RECALLED = {Held.RECALLED: Held.STOPPED, Held.RECALLED_KEPT: Held.KEPT}


class Hold:
    """Whether an agent carries out the decisions of its copy.

    A stop that is asked of an agent counts there at once, and one that is applied when it is. The history tells which
    starts were asked for after it: an agent that asks for one has applied all steps before it. So a start ends the hold
    if the stop is a step before it. If the stop is no step of the history, since its term has ended or another history
    counts, the agent has a step of its own made, a hold, and the starts after that end it.

    The stop of an earlier process waits likewise, until the history that counts has come to the step that it had.

    Args:
        agent: Which agent.

    Attributes:
        held: How the agent obeys the last stop.
        last: The token of the last stop that it took.
        at: Where that stands in the history, or stood in that of an earlier process.
    """

    def __init__(self, agent: str) -> None:
        self.agent = agent
        self.held = Held.ACTING
        self.last = ""
        self.at: Position | None = None

    @property
    def still(self) -> bool:
        """Whether the agent carries out no decisions."""
        return self.held is not Held.ACTING

    @property
    def waits(self) -> str:
        """The token of the stop that is in no history of this agent's yet; empty where there is none."""
        return self.last if self.held in {Held.ASKED, Held.RECALLED, Held.RECALLED_KEPT} else ""

    def stop(self, token: str) -> None:
        """Take a stop that is asked of this agent."""
        self.held, self.last, self.at = Held.ASKED, token, None

    @property
    def standstill(self) -> Standstill | None:
        """The stop, for the next process to obey; None where the agent acts."""
        return Standstill(self.last, self.at, self.held in {Held.KEPT, Held.RECALLED_KEPT}) if self.still else None

    def recall(self, standstill: Standstill) -> None:
        """Obey the stop of an earlier process."""
        self.last, self.at = standstill.token, standstill.at
        recalled = Held.RECALLED_KEPT if standstill.kept else Held.RECALLED
        self.held = Held.ASKED if self.at is None else recalled

    def take(self, commit: Commit, position: Position) -> None:
        """Take note of a step that is applied."""
        waits = self.waits
        if commit.command in BARS:
            if waits and position == self.at:
                self.held = _RECALLED[self.held]
            elif waits and commit.by == self.agent and commit.token == waits:
                self.held, self.at = Held.KEPT if commit.command == HOLD else Held.STOPPED, position
            elif commit.command == STOP and not waits:
                self.held, self.last, self.at = Held.STOPPED, commit.token, position
        elif commit.command in {"start", "resume"} and not waits:
            self.held = Held.ACTING

    def restore(self, lineage: Lineage, *, running: bool) -> None:
        """Take note of another history, after whose last step the team decides or does not."""
        if self.at is None or not self.still:
            return
        if not contains(lineage, self.at):
            self.held, self.at = Held.ASKED, None
            return
        self.held = _RECALLED.get(self.held, self.held)
        if running and self.held is Held.STOPPED:
            self.held = Held.ACTING
