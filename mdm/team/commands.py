"""What became of commands: of each that was asked of an agent, or that it has done, for whoever asks afterwards."""

from __future__ import annotations

__all__ = ["DONE", "PENDING", "Commands"]

PENDING = "pending"
DONE = "done"

_MOST = 32


class Commands:
    """The last commands of one agent, by their tokens, and what became of each.

    A token is what a command is known by, the same at all agents that are asked for the same.

    Args:
        agent: Which agent, for the tokens of what is asked for here.
        life: Which life of it.

    Attributes:
        outcomes: ``pending``, ``done``, or ``void: `` and the reason, by token; the oldest first.
    """

    def __init__(self, agent: str, life: int) -> None:
        self._name = f"{agent}.{life:x}"
        self._count = 0
        self._names: dict[str, str] = {}
        self.outcomes: dict[str, str] = {}

    def ask(self, command: str, token: str | None) -> str:
        """Take note of a command that is asked for; return its token, which is made here where none is given."""
        if token is None:
            self._count += 1
            token = f"{self._name}.{self._count}"
        self._set(token, PENDING)
        self._names[token] = command
        return token

    def name(self, token: str) -> str:
        """Return which command was asked for here."""
        return self._names.get(token, "a command")

    def done(self, token: str) -> None:
        """Take note of a command that is done here."""
        if token:
            self._set(token, DONE)

    def void(self, token: str, reason: str) -> None:
        """Take note of a command that will not be done."""
        self._set(token, f"void: {reason}")

    def _set(self, token: str, outcome: str) -> None:
        self.outcomes.pop(token, None)
        self.outcomes[token] = outcome
        if len(self.outcomes) > _MOST:
            oldest = next(iter(self.outcomes))
            del self.outcomes[oldest]
            self._names.pop(oldest, None)
