"""The output of verbs: JSON, tables, names from files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence


def as_json(value: Any) -> str:
    """Return one line of JSON; arrays become lists."""
    return msgspec.json.encode(value, enc_hook=_encode).decode()


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__} cannot be encoded as JSON")


def columns(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> Iterator[str]:
    """Yield the rows of a table as lines, in columns as wide as their widest cells.

    Args:
        rows: The rows, of as many cells each.
        right: The columns whose cells end below each other; those of the others begin so.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            cell.rjust(width) if place in right else cell if place == len(row) - 1 else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells) if row[-1] else "  ".join(cells).rstrip()


def printable(name: str, room: int = 80) -> str:
    """Return a name from a file for a terminal: unprintable characters are escaped, and a long end is cut off."""
    shown = name if name.isprintable() else repr(name)[1:-1]
    return shown if len(shown) <= room else f"{shown[: room - 1]}…"
