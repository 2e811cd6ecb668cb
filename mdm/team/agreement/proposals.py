"""What an agent has to say to the next steps: its components and commands, until a step has taken them."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mdm.team.agreement.entries import Commit, Term

__all__ = ["Proposals"]

WAITING = 64
"""Components that happen before a step can take them, in event-driven teams; the oldest is lost beyond."""

COMMANDS = 16
"""Commands that wait."""


class Proposals:
    """An agent's own components and commands, in their order.

    A component that was offered for a step counts for that step alone. Where the step went without it, an event is
    offered anew for the next one, and a reading of a fixed rate is dropped, since the next is on its way. Where a
    command became the step, which takes no components, both are offered anew.
    """

    def __init__(self, agent: str, *, event_driven: bool) -> None:
        self.agent = agent
        self.event_driven = event_driven
        self.components: deque[bytes | None] = deque()
        self.commands: deque[str] = deque()
        self.offered: tuple[Term, int] | None = None
        self.commanded: tuple[Term, int] | None = None
        self.dropped = 0

    def add(self, component: bytes | None, command: str | None) -> None:
        """Take what is to be proposed."""
        if command is not None:
            if len(self.commands) == COMMANDS:
                self.dropped += 1
            else:
                self.commands.append(command)
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

    def settle(self, commit: Commit) -> None:
        """Take note of a step that was applied."""
        if commit.command is not None:
            if commit.by == self.agent and self.commanded == (commit.term, commit.step):
                self.commands.popleft()
        elif self.offered == (commit.term, commit.step) and self.components:
            taken = self.agent in commit.inputs or self.components[0] is None
            if taken or not self.event_driven:
                self.components.popleft()
                self.dropped += not taken
        self.offered = self.commanded = None

    def renew(self) -> None:
        """Take note of a new term, in which nothing was offered yet; a reading from before it is too old."""
        if not self.event_driven:
            self.dropped += len(self.components)
            self.components.clear()
        self.offered = self.commanded = None

    def forget(self, step: int) -> None:
        """Take note of a snapshot, which holds what was decided up to a step; what was offered until then is past."""
        if self.offered is not None and self.offered[1] <= step:
            self.components.popleft()
        self.offered = self.commanded = None
