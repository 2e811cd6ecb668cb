"""MADP's ``.vf`` files: alpha vectors, a block each.

A block is a line with the action's index and a second number (an index of MADP's planners, of no matter here), a line
with a number for every state, and a blank line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.formats.cassandra import LARGEST
from mdm.formats.source import Source, number as number_of
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read"]

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
    lines = [(number, line.split()) for number, line in enumerate(source.text.split("\n"), 1) if line.strip()]
    actions: list[int] = []
    vectors: list[list[float]] = []
    for (number, head), (vector_number, words) in zip(lines[::2], lines[1::2], strict=False):
        action = _action(source, number, head, num_actions)
        if action is None:
            continue
        actions.append(action)
        values = [number_of(word) for word in words]
        if None in values:
            wrong = words[values.index(None)]
            source.fail(f"a line of numbers was expected, but {wrong[:40]!r} stands in it", line=vector_number)
        vectors.append([value for value in values if value is not None])
        if not np.isfinite(vectors[-1]).all():
            source.fail("a value is not finite", line=vector_number)
        if len(vectors[-1]) != len(vectors[0]):
            source.fail(f"{len(vectors[0])} values were expected, but {len(words)} are given", line=vector_number)
    if len(lines) % 2:
        source.fail("the file ends after an action's line: its vector is missing", line=lines[-1][0])
    if not vectors:
        source.fail("the file holds no vector of an action")
    return AlphaVectors(vectors, actions, num_actions)


def _action(source: Source, line: int, words: list[str], num_actions: int | None) -> int | None:
    """Return the action that a block is for, or None where it is for none."""
    if len(words) != 2 or not words[0].isdecimal() or not words[1].lstrip("-").isdecimal():
        source.fail(f"an action's index and a second number were expected, not {' '.join(words)[:40]!r}", line=line)
    if words[0] == _NO_ACTION:
        return None
    if num_actions is not None and int(words[0]) >= num_actions:
        source.fail(f"there is no action {words[0]}: the model's {num_actions} count from 0", line=line)
    if int(words[0]) > LARGEST:
        source.fail(f"{words[0][:40]} is no action's index: at most {LARGEST} is possible", line=line)
    return int(words[0])
