"""The history of an agent's copy: which steps it has applied, and the last of them for those who missed some."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.team.agreement.entries import START, Position

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.team.agreement.entries import Commit

__all__ = ["History", "contains"]

TERMS = 16
"""Terms of which a lineage keeps the last step. Who left before the oldest of them takes a snapshot."""


class History:
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
        """Return what follows a position, up to so many commits; None where that is not known."""
        if not contains(self.lineage, position):
            return None
        held = len(self.commits) - (self.position.step - position.step)
        return tuple(self.commits[held : held + limit]) if held >= 0 else None


def contains(lineage: Sequence[Position], position: Position) -> bool:
    """Return whether a history of this lineage has a position in it."""
    return any(last.term == position.term and position.step <= last.step for last in lineage)
