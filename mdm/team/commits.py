"""Commits as they are told: what the agents of a team agreed on, step by step, for tests and files of decisions."""

from __future__ import annotations

import msgspec

from mdm.messages import Message

__all__ = ["Committed"]


class Committed(Message, frozen=True, gc=False):
    """A joint step that this agent has applied.

    Args:
        agent: Which agent's copy.
        ensemble: Of which ensemble.
        term: The number of its term, the term's leader, and which life of it.
        step: Counted from 1.
        input: What the agents said, by agent and in names; those who saw nothing are left out.
        missing: Agents of which it is not known what they saw.
        command: ``start``, ``stop``… where the step is one; else None.
        action: The joint action after it, None where there is none.
        digest: Of the copy after it.
        caught_up: Whether others took it before this agent heard of it, which did nothing of it then; of the last one
            of these it does the action from now on.
    """

    agent: str
    ensemble: str
    term: tuple[int, str, int]
    step: int
    input: dict[str, str | tuple[str | None, ...] | None]
    missing: tuple[str, ...]
    command: str | None
    action: str | None
    digest: str
    caught_up: bool = False

    def line(self) -> bytes:
        """Return it as a line of JSON, with its time in seconds."""
        told: dict[str, object] = {"agent": self.agent, "ensemble": self.ensemble, "term": self.term}
        told |= {"step": self.step, "time": self.time / 1e9, "input": self.input, "missing": self.missing}
        if self.command is not None:
            told["command"] = self.command
        told |= {"action": self.action, "digest": self.digest}
        if self.caught_up:
            told["caught_up"] = True
        return msgspec.json.encode(told) + b"\n"
