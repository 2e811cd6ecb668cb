"""Cassandra's ``.alpha`` format: a block per alpha vector.

A block is a line with the action's index, a line with a number per state, and a blank line. Values are rewards or
negated costs: greater is better. Robots' projects also write the action's name, and comments behind ``#``.
"""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.formats.source import LARGEST, Source, number as number_of
from mdm.formats.target import write_text
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import numpy.typing as npt

    from mdm.models import Space


def read(path: str | Path, *, actions: Space | None = None) -> AlphaVectors:
    """Read alpha vectors.

    Args:
        path: The file.
        actions: The model's actions, if known; without them names count in the order of the file.

    Raises:
        FormatError: If the file is malformed, with the line and the expected form.
    """
    vectors, indices, named = _read(path, actions, None if actions is None else len(actions))
    policy = AlphaVectors(vectors, indices, None if actions is None else len(actions))
    if actions is None:
        policy.named = named
    return policy


def read_in_order(
    path: str | Path, *, num_actions: int | None = None
) -> tuple[list[npt.NDArray[np.float64]], list[int]]:
    """Return a file's vectors and actions in file order, which is the order of a policy graph's nodes.

    Raises:
        FormatError: As `read` does.
    """
    return _read(path, None, num_actions)[:2]


def _read(
    path: str | Path, space: Space | None, num_actions: int | None
) -> tuple[list[npt.NDArray[np.float64]], list[int], tuple[str, ...]]:
    source = Source(path)
    named: dict[str, int] = {}

    def action(line: int, words: list[str]) -> int:
        if len(words) == 1 and words[0].isdecimal():
            return action_index(source, line, words[0], num_actions)
        name = " ".join(words)
        if number_of(words[0]) is not None:
            source.fail(f"an action's index or name was expected, not {name[:40]!r}", line=line)
        if space is None:
            return named.setdefault(name, len(named))
        try:
            return space.index(name)
        except ModelError as error:
            source.fail(str(error), line=line)

    vectors, indices = blocks(source, action)
    return vectors, indices, tuple(named)


def write(policy: AlphaVectors, path: str | Path) -> None:
    """Write alpha vectors to a file; reading it gives the same numbers."""
    write_text(path, lines(policy.vectors, policy.actions))


def lines(vectors: npt.NDArray[np.float64], actions: Sequence[int], after_action: str = "") -> str:
    """Return the blocks of vectors and actions, with numbers in the shortest form that restores them."""
    rows = zip(actions, vectors.tolist(), strict=True)
    return "".join(f"{action}{after_action}\n{' '.join(map(repr, row))}\n\n" for action, row in rows)


def blocks(
    source: Source, action_of: Callable[[int, list[str]], int | None]
) -> tuple[list[npt.NDArray[np.float64]], list[int]]:
    """Return the vectors and actions of a text of two-line blocks.

    Args:
        source: The text.
        action_of: Parses a block's first line, given its number and words, to the action, or to None for a block
            without one.

    Raises:
        FormatError: If the text is malformed, with the line and the expected form.
    """
    lines = enumerate(source.text.split("\n"), 1)
    texts = [(number, words) for number, line in lines if (words := line.partition("#")[0].split())]
    actions: list[int] = []
    vectors: list[npt.NDArray[np.float64]] = []
    for (number, head), (vector_number, words) in zip_longest(texts[::2], texts[1::2], fillvalue=(0, [])):
        source.report(min(2 * len(vectors) / len(texts), 1.0))
        action = action_of(number, head)
        if not words:
            source.fail("the file ends after an action, without its vector", line=number)
        if action is None:
            continue
        vector = numbers(source, vector_number, words)
        if not np.isfinite(vector).all():
            source.fail("a value is not finite", line=vector_number)
        if vectors and len(vector) != len(vectors[0]):
            source.fail(f"{len(vectors[0])} values were expected, but {len(words)} are given", line=vector_number)
        actions.append(action)
        vectors.append(vector)
    source.report(1.0)
    if not vectors:
        source.fail("the file holds no alpha vectors")
    return vectors, actions


def numbers(source: Source, line: int, words: list[str]) -> npt.NDArray[np.float64]:
    """Parse the words of a line as numbers.

    Raises:
        FormatError: If a word is not a number.
    """
    values = [number_of(word) for word in words]
    if None in values:
        wrong = words[values.index(None)]
        source.fail(f"a line of numbers was expected, not {wrong[:40]!r}", line=line)
    return np.array(values, dtype=np.float64)


def action_index(source: Source, line: int, word: str, num_actions: int | None) -> int:
    """Parse a word of decimal digits as an action's index.

    Raises:
        FormatError: If the model has no such action, or no model can have it.
    """
    action = int(word) if len(word) < 20 else LARGEST + 1
    if num_actions is not None and action >= num_actions:
        source.fail(f"there is no action {word[:40]}: the model has actions 0 to {num_actions - 1}", line=line)
    if action > LARGEST:
        source.fail(f"{word[:40]} is not an action's index: at most {LARGEST} is possible", line=line)
    return action
