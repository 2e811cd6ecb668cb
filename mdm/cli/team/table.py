"""Tables of agents' answers, in aligned columns."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["table"]


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines of aligned columns, below the columns' names; a row may end before the last column."""
    wide = [list(columns), *rows]
    widths = [max((len(row[place]) for row in wide if place < len(row)), default=0) for place in range(len(columns))]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=False)).rstrip() for row in wide]
