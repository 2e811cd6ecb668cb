"""MADP's Q-tables, a line per state with a number per action; and alpha vectors in lines, which look like one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mdm.formats.cassandra.alpha import numbers
from mdm.formats.source import Source
from mdm.formats.target import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.policies import QTable


def read(path: str | Path) -> npt.NDArray[np.float64]:
    """Read a table of states x actions.

    Raises:
        FormatError: If the file is malformed, with the line and the expected form.
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


def are_vectors(rows: list[list[str]]) -> bool:
    """Whether lines of numbers are alpha vectors, each behind its action's index, and no table.

    They are if each line begins with an index, not always the same, and most have numbers beside it that are none.
    """
    first = {row[0] for row in rows if row}
    if len(first) < 2 or not all(word.isdecimal() for word in first):
        return False
    broken = [any("." in word for word in row[1:]) for row in rows if row]
    return all(len(row) > 2 for row in rows if row) and 2 * sum(broken) > len(broken)


def write(table: QTable, path: str | Path) -> None:
    """Write a Q-table to a file; reading it gives the same numbers."""
    text = "".join(f"{' '.join(map(repr, row))}\n" for row in table.values.tolist())
    write_text(path, text)
