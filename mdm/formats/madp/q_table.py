"""MADP's Q-tables: a line per state with a number per action."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mdm.formats.cassandra.alpha import numbers
from mdm.formats.source import Source
from mdm.formats.target import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.models import MDP
    from mdm.policies import QTable

__all__ = ["read", "refuse_vectors", "write"]


def read(path: str | Path) -> npt.NDArray[np.float64]:
    """Read a table of states x actions.

    Raises:
        FormatError: If the file is malformed, with the line and what was expected.
    """
    source = Source(path)
    rows: list[npt.NDArray[np.float64]] = []
    for line, text in enumerate(source.text.split("\n"), 1):
        words = text.split()
        if not words:
            continue
        row = numbers(source, line, words)
        if rows and len(row) != len(rows[0]):
            source.fail(f"{len(rows[0])} values were expected, but {len(row)} are given", line=line)
        rows.append(row)
    return np.array(rows)


def refuse_vectors(source: Source, model: MDP | None) -> None:
    """Refuse lines of an action's index and the numbers of an alpha vector, which look like a Q-table.

    Raises:
        FormatError: If they do not have the model's shape, or there is none, and all begin with an index and go on with
            numbers that are none.
    """
    rows = [line.split() for line in source.text.split("\n") if line.strip()]
    if model is not None and (len(rows), len(rows[0])) == (len(model.state_space), len(model.action_space)):
        return
    first = {row[0] for row in rows}
    indices = all(word.isdecimal() for word in first) and len(first) > 1
    if indices and all(len(row) > 2 and any("." in word for word in row[1:]) for row in rows):
        source.fail(
            "every line begins with an index, as of an action before its alpha vector: in an .alpha file the vector "
            "has a line of its own (if these are values of actions, say kind='q')",
            line=1,
        )


def write(table: QTable, path: str | Path) -> None:
    """Write a Q-table to a file; reading it gives the same numbers."""
    text = "".join(f"{' '.join(map(repr, row))}\n" for row in table.values.tolist())
    write_text(path, text)
