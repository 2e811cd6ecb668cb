"""MADP's ``.vf`` format: a block per alpha vector.

A block is a line with the action's index and a second number (an index of MADP's planners, ignored here), a line with
a number per state, and a blank line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.formats.cassandra import alpha
from mdm.formats.source import Source, suffixes
from mdm.formats.target import write_text
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from pathlib import Path

_NO_ACTION = "2147483647"
"""MADP's index for a vector without an action, which can never be chosen."""


def read(path: str | Path, *, num_actions: int | None = None) -> AlphaVectors:
    """Read a value function.

    Args:
        path: The file.
        num_actions: The model's number of actions, if known.

    Raises:
        FormatError: If the file is malformed, with the line and the expected form.
    """
    source = Source(path)
    if suffixes(path) == ".vf" and not source.text.endswith("\n"):
        # MADP ends every block with a blank line; a number without a line's end may have lost digits.
        source.fail("the file is truncated: it ends within a line", line=source.text.count("\n") + 1)

    def action(line: int, words: list[str]) -> int | None:
        if len(words) != 2 or not words[0].isdecimal() or not words[1].lstrip("-").isdecimal():
            message = f"an action's index and a second number were expected, not {' '.join(words)[:40]!r}"
            source.fail(message, line=line)
        return None if words[0] == _NO_ACTION else alpha.action_index(source, line, words[0], num_actions)

    vectors, actions = alpha.blocks(source, action)
    return AlphaVectors(vectors, actions, num_actions)


def write(policy: AlphaVectors, path: str | Path) -> None:
    """Write a value function that MADP can read; reading it gives the same numbers."""
    write_text(path, alpha.lines(policy.vectors, policy.actions, " -1"))
