"""The log: the joint steps that an agent has applied, and the last of them for agents that missed some."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import msgspec

from mdm.team.transport.bounds import Life, Name, Number, Order, Text

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["START", "Commit", "Lineage", "Log", "Members", "Position", "Term", "contains"]

TERMS = 16
"""Terms of which a lineage keeps the last step. An agent that left before the oldest of them takes a snapshot."""


class Term(msgspec.Struct, frozen=True, order=True, array_like=True, gc=False):
    """A time in which one agent leads; a later one is greater. No two calls of any agents make the same.

    Args:
        number: Grows with each change of membership.
        leader: The agent that called it.
        incarnation: Which life of that agent.
    """

    number: Number
    leader: Name
    incarnation: Life


class Position(msgspec.Struct, frozen=True, order=True, array_like=True, gc=False):
    """A place in a history: the last step that was applied, and the term that committed it."""

    term: Term
    step: Number


Lineage: TypeAlias = Annotated[tuple[Position, ...], msgspec.Meta(min_length=1, max_length=64)]
Members: TypeAlias = Annotated[tuple[Name, ...], msgspec.Meta(max_length=256)]
"""The last steps of the terms in a history; its own last step is the last of them."""

START = Position(Term(0, "", 0), 0)
"""Where every history begins: nothing was applied."""


class Commit(msgspec.Struct, frozen=True, array_like=True, tag="commit", gc=False):
    """A joint step, which every copy applies in its turn.

    Args:
        term: Who committed it, and when.
        step: Counted from 1, over all terms.
        previous: The term of the step before: together with ``step`` it says which history this goes on.
        inputs: The components by agent, in the order of the team; an agent that saw nothing has none.
        missing: Agents whose component is not known.
        command: ``"start"``, ``"stop"``, ``"reset"``…: such a step has neither inputs nor missing agents.
        by: Who gave the command.
        digest: Of the leader's copy after the step before.
        token: The identifier of the command.
    """

    term: Term
    step: Number
    previous: Term
    inputs: Annotated[dict[Name, bytes], msgspec.Meta(max_length=256)]
    missing: Members
    command: Order | None
    by: Name
    digest: Text
    token: Name = ""


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


def contains(lineage: Sequence[Position], position: Position) -> bool:
    """Return whether a history of this lineage has a position in it."""
    return any(last.term == position.term and position.step <= last.step for last in lineage)
