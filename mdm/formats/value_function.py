"""MADP's ``.vf`` files: alpha vectors, a block each.

A block is a line with the action's index and a second number (an index of MADP's planners, of no matter here), a line
with a number for every state, and a blank line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.formats.source import Source
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read"]

_NO_ACTION = 2**31 - 1
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
        if len(head) != 2 or not head[0].isdecimal() or not head[1].lstrip("-").isdecimal():
            source.fail(
                f"an action's index and a second number were expected, not {' '.join(head)[:40]!r}", line=number
            )
        if int(head[0]) == _NO_ACTION:
            continue
        if num_actions is not None and int(head[0]) >= num_actions:
            source.fail(f"there is no action {head[0]}: the model's {num_actions} count from 0", line=number)
        actions.append(int(head[0]))
        try:
            vectors.append([float(word) for word in words])
        except ValueError as error:
            source.fail(f"a line of numbers was expected: {error}", line=vector_number)
        if not np.isfinite(vectors[-1]).all():
            source.fail("a value is not finite", line=vector_number)
        if len(vectors[-1]) != len(vectors[0]):
            source.fail(f"{len(vectors[0])} values were expected, but {len(words)} are given", line=vector_number)
    if len(lines) % 2:
        source.fail("the file ends after an action's line: its vector is missing", line=lines[-1][0])
    if not vectors:
        source.fail("the file holds no vector of an action")
    return AlphaVectors(vectors, actions, num_actions)
