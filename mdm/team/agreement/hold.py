"""What keeps an agent stopped: the last stop that it took, until a start that was asked for after it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.team.agreement.history import contains

if TYPE_CHECKING:
    from mdm.team.agreement.entries import Commit, Lineage, Position

__all__ = ["BARS", "HOLD", "OPENS", "STARTS", "STOP", "Hold"]

STOP = "stop"

HOLD = "hold"
"""The command by which an agent says that it stays stopped: nobody else stops, and what starts the team from then on
was asked for by somebody who knows of it."""

BARS = frozenset({STOP, HOLD})
"""Commands that beat each start that was asked for before them."""

STARTS = frozenset({"start", "resume", "begin"})
"""Commands after which a team decides; the last is the team's own, and ends no hold."""

OPENS = STARTS | {"reset"}
"""Commands that a stop beats."""


class Hold:
    """Whether an agent acts where its copy decides.

    A stop that is asked of an agent counts there at once, and one that is applied when it is. Which starts were asked
    for after it the history tells: whoever asks for one has applied all steps before it. So a start ends the hold where
    that is a step before it. Where the stop is none of the history's, since its term has ended or another history
    counts, the agent has a step of its own made, a hold, and the starts after that end it.

    Args:
        agent: Which agent.

    Attributes:
        still: Whether the agent does nothing of what is decided.
        waits: The token of the stop that is in no history of this agent's yet; empty where there is none.
        last: The token of the last stop that it took.
        at: Where that stands in the history.
        kept: Whether the step there is a hold, which tells nothing of whether the team decides.
    """

    def __init__(self, agent: str) -> None:
        self.agent = agent
        self.still = False
        self.waits = ""
        self.last = ""
        self.at: Position | None = None
        self.kept = False

    def stop(self, token: str) -> None:
        """Take a stop that is asked of this agent."""
        self.still = True
        self.waits = self.last = token
        self.at = None

    def take(self, commit: Commit, position: Position) -> None:
        """Take note of a step that is applied."""
        if commit.command in BARS:
            if commit.by == self.agent and commit.token == self.waits:
                self.waits = ""
                self.at, self.kept = position, commit.command == HOLD
            elif commit.command == STOP and not self.waits:
                self.still = True
                self.last, self.at, self.kept = commit.token, position, False
        elif commit.command in {"start", "resume"} and not self.waits:
            self.still = False

    def restore(self, lineage: Lineage, *, running: bool) -> None:
        """Take note of another history, after whose last step the team decides or does not."""
        if not self.still or self.waits:
            return
        if self.at is None or not contains(lineage, self.at):
            self.waits = self.last
        elif running and not self.kept:
            self.still = False
