"""MADP's ``.vf`` files: alpha vectors, a block each.

A block is a line with the action's index and a second number (an index of MADP's planners, of no matter here), a line
with a number for every state, and a blank line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.formats.source import Source
from mdm.formats.target import write_text
from mdm.formats.vectors import alpha
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read", "write"]

_NO_ACTION = "2147483647"
"""What MADP writes for a vector that belongs to no action; it can never be chosen."""


def read(path: str | Path, *, num_actions: int | None = None) -> AlphaVectors:
    """Return the value function in a file.

    Args:
        path: The file.
        num_actions: How many actions the model has, where that is known.

    Raises:
        FormatError: With the line, what stands there and what was expected.
    """
    source = Source(path)

    def action(line: int, words: list[str]) -> int | None:
        if len(words) != 2 or not words[0].isdecimal() or not words[1].lstrip("-").isdecimal():
            message = f"an action's index and a second number were expected, not {' '.join(words)[:40]!r}"
            source.fail(message, line=line)
        return None if words[0] == _NO_ACTION else alpha.action_index(source, line, words[0], num_actions)

    vectors, actions = alpha.blocks(source, action)
    return AlphaVectors(vectors, actions, num_actions)


def write(policy: AlphaVectors, path: str | Path) -> None:
    """Write a value function to a file; MADP reads it, and reading it gives the same numbers."""
    write_text(path, alpha.lines(policy.vectors, policy.actions, " -1"))
