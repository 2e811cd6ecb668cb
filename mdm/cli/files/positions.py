"""Positions: the line and column of each key of a TOML text, which `tomllib` leaves out."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

Path = tuple[str, ...]
"""The keys from the top of a document to one of its values; all elements of an array have the keys of the array."""

_GAP = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BLANK = re.compile(r"[ \t]*")
_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_SCALAR = re.compile(
    r'''"""(?:[^\\]|\\.)*?"""(?:""?)?'''
    r"""|\'\'\'.*?\'\'\'(?:\'\'?)?"""
    r"""|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'"""
    r"""|\d{4}-\d\d-\d\d \d\d:[^\s,\]}#]*|[^\s,\]}#]+""",
    re.DOTALL,
)


class Positions:
    """Where the keys of a document are written.

    Example::

        Positions("robot = { speed = 1 }").of(("robot", "speed"))  # (1, 11)

    Args:
        text: The text, which `tomllib` reads without an error.

    Attributes:
        offsets: Where each key first begins, in characters from the beginning.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self.offsets: dict[Path, int] = {}
        table: Path = ()
        while self._skip(_GAP) < len(text):
            if text[self._at] != "[":
                self._pair(table)
                continue
            brackets = 2 if text.startswith("[[", self._at) else 1
            self._at += brackets
            table = self._below(())
            self._at += brackets

    def of(self, path: Sequence[str]) -> tuple[int, int]:
        """Return the line and the column, from 1, of a key; of one that is not written, those of the nearest above."""
        above = (tuple(path[:length]) for length in range(len(path), 0, -1))
        offset = next((self.offsets[keys] for keys in above if keys in self.offsets), 0)
        return self._text.count("\n", 0, offset) + 1, offset - self._text.rfind("\n", 0, offset)

    def _skip(self, pattern: re.Pattern[str]) -> int:
        """Go behind a match of the pattern, if there is one here; return where that is."""
        if (match := pattern.match(self._text, self._at)) is not None:
            self._at = match.end()
        return self._at

    def _below(self, path: Path) -> Path:
        """Take a key, in parts perhaps, and the blanks behind it; return the keys down to it."""
        while True:
            start = self._skip(_BLANK)
            name = self._text[start : self._skip(_KEY)]
            path = (*path, tomllib.loads(f"k = {name}")["k"] if name[0] in "\"'" else name)
            self.offsets.setdefault(path, start)
            if not self._text.startswith(".", self._skip(_BLANK)):
                return path
            self._at += 1

    def _pair(self, table: Path) -> None:
        """Take a key with its value."""
        path = self._below(table)
        self._at += 1  # the sign =
        self._value(path)

    def _value(self, path: Path) -> None:
        """Take a value, with the keys in it."""
        opening = self._text[self._skip(_GAP)]
        if opening not in "[{":
            self._skip(_SCALAR)
            return
        self._at += 1
        while self._text[self._skip(_GAP)] not in "]}":
            if opening == "{":
                self._pair(path)
            else:
                self._value(path)
            if self._text[self._skip(_GAP)] == ",":
                self._at += 1
        self._at += 1
