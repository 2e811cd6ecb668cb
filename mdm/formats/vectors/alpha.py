"""Cassandra's ``.alpha`` files: alpha vectors, a block each.

A block is a line with the action's index, a line with a number for every state, and a blank line. Values are of
rewards, or of negated costs, so that the greatest is the best.
"""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from mdm.formats.cassandra.model import LARGEST
from mdm.formats.source import Source, number as number_of
from mdm.formats.target import write_text
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import numpy.typing as npt

__all__ = ["action_index", "blocks", "lines", "numbers", "read", "read_in_order", "write"]


def read(path: str | Path, *, num_actions: int | None = None) -> AlphaVectors:
    """Return the alpha vectors in a file.

    Args:
        path: The file.
        num_actions: How many actions the model has, where that is known.

    Raises:
        FormatError: With the line, what stands there and what was expected.
    """
    vectors, actions = read_in_order(path, num_actions=num_actions)
    return AlphaVectors(vectors, actions, num_actions)


def read_in_order(
    path: str | Path, *, num_actions: int | None = None
) -> tuple[list[npt.NDArray[np.float64]], list[int]]:
    """Return a file's vectors and their actions in its own order, which is that of the nodes of a policy graph.

    Raises:
        FormatError: As `read` does.
    """
    source = Source(path)

    def action(line: int, words: list[str]) -> int:
        if len(words) != 1 or not words[0].isdecimal():
            source.fail(f"an action's index was expected, not {' '.join(words)[:40]!r}", line=line)
        return action_index(source, line, words[0], num_actions)

    return blocks(source, action)


def write(policy: AlphaVectors, path: str | Path) -> None:
    """Write alpha vectors to a file; reading it gives the same numbers."""
    write_text(path, lines(policy.vectors, policy.actions))


def lines(vectors: npt.NDArray[np.float64], actions: Sequence[int], after_action: str = "") -> str:
    """Return the blocks of vectors and their actions, each number with as many digits as tell it from others."""
    rows = zip(actions, vectors.tolist(), strict=True)
    return "".join(f"{action}{after_action}\n{' '.join(map(repr, row))}\n\n" for action, row in rows)


def blocks(
    source: Source, action_of: Callable[[int, list[str]], int | None]
) -> tuple[list[npt.NDArray[np.float64]], list[int]]:
    """Return the vectors in a text of pairs of lines, and the action of each.

    Args:
        source: The text.
        action_of: Returns the action that the first line of a block tells (given its number and words), or None where
            the block is for no action.

    Raises:
        FormatError: With the line, what stands there and what was expected.
    """
    texts = [(number, line.split()) for number, line in enumerate(source.text.split("\n"), 1) if line.strip()]
    actions: list[int] = []
    vectors: list[npt.NDArray[np.float64]] = []
    for (number, head), (vector_number, words) in zip_longest(texts[::2], texts[1::2], fillvalue=(0, [])):
        action = action_of(number, head)
        if not words:
            source.fail("the file ends after an action's line: its vector is missing", line=number)
        if action is None:
            continue
        vector = numbers(source, vector_number, words)
        if not np.isfinite(vector).all():
            source.fail("a value is not finite", line=vector_number)
        if vectors and len(vector) != len(vectors[0]):
            source.fail(f"{len(vectors[0])} values were expected, but {len(words)} are given", line=vector_number)
        actions.append(action)
        vectors.append(vector)
    if not vectors:
        source.fail("the file holds no vector of an action")
    return vectors, actions


def numbers(source: Source, line: int, words: list[str]) -> npt.NDArray[np.float64]:
    """Return the numbers that a line's words stand for.

    Raises:
        FormatError: If one is no number.
    """
    values = [number_of(word) for word in words]
    if None in values:
        wrong = words[values.index(None)]
        source.fail(f"a line of numbers was expected, but {wrong[:40]!r} stands in it", line=line)
    return np.array(values, dtype=np.float64)


def action_index(source: Source, line: int, word: str, num_actions: int | None) -> int:
    """Return the action that a word of decimal digits stands for.

    Raises:
        FormatError: If the model has no such action, or no model could.
    """
    action = int(word) if len(word) < 20 else LARGEST + 1
    if num_actions is not None and action >= num_actions:
        source.fail(f"there is no action {word[:40]}: the model's {num_actions} count from 0", line=line)
    if action > LARGEST:
        source.fail(f"{word[:40]} is no action's index: at most {LARGEST} is possible", line=line)
    return action
