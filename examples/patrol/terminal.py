"""A terminal on which the same view is drawn again and again, as large as the terminal is at that moment."""

from __future__ import annotations

import shutil
import sys
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Iterable

OWN_SCREEN, NO_CURSOR, NO_WRAPPING, AT_ONCE = 1049, 25, 7, 2026  # modes that terminals have, or else ignore


class Terminal:
    """What is drawn between entering and leaving is on a screen of its own: what was there before is there again."""

    def __enter__(self) -> Self:
        print(f"\x1b[?{OWN_SCREEN}h\x1b[?{NO_CURSOR}l\x1b[?{NO_WRAPPING}l\x1b[2J", end="", flush=True)
        return self

    def __exit__(self, *_: object) -> None:
        if not sys.stdout.closed:
            print(f"\x1b[0m\x1b[?{NO_WRAPPING}h\x1b[?{NO_CURSOR}h\x1b[?{OWN_SCREEN}l", end="", flush=True)

    @property
    def size(self) -> tuple[int, int]:
        """How many columns and rows it has now; the last row stays empty."""
        columns, rows = shutil.get_terminal_size()
        return max(columns, 20), max(rows, 8) - 1

    def show(self, lines: Iterable[str]) -> None:
        """Draw lines in the place of the last ones."""
        drawn = "\n".join(f"\x1b[0m\x1b[K{line}" for line in lines)
        print(f"\x1b[?{AT_ONCE}h\x1b[H{drawn}\x1b[0m\n\x1b[J\x1b[?{AT_ONCE}l", end="", flush=True)
