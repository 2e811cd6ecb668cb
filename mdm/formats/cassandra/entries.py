"""Block-wise reading of statements for single entries.

Large files mostly repeat a few forms of statement. After one statement of a form has been parsed word by word, those
that follow it with other symbols and numbers are parsed column by column: 1,000,000 entries take 2 s instead of 9 s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.formats.source import number

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.formats.cassandra.probabilities import Places

__all__ = ["Entries"]

_FIRST_BLOCK, _LAST_BLOCK = 16, 65_536


class Entries:
    """Reads and collects single entries of the kinds ``T``, ``O`` and ``R``.

    Args:
        words: The file's words.
        symbol: Returns the index of the single symbol that some words name, else None. Its arguments are the kind of
            statement, the field's letter, the place in the file, and the words.
        store: Called in file order with the entries' kind, action, further symbols and values.
    """

    def __init__(
        self,
        words: list[str],
        symbol: Callable[[str, str, int, list[str]], int | None],
        store: Callable[[str, int | None, list[Places], Any], None],
    ) -> None:
        self._words = words
        self._symbol = symbol
        self._store = store
        self._known: dict[str, dict[Any, int]] = {}
        self._forms: dict[str, _Form] = {}
        self._kept: dict[str, _Columns] = {}

    def learn(self, kind: str, words: list[str], named: list[tuple[int, int, str]], wild: tuple[bool, ...]) -> None:
        """Learn the form of a statement for a single entry.

        Args:
            kind: ``T``, ``O`` or ``R``.
            words: The words of the statement; the value is the last.
            named: Beginning, end and letter of each field that names a symbol.
            wild: Whether each field is ``*``.
        """
        self._forms[kind] = _Form(words, named, wild)

    def read(self, kind: str, begin: int) -> int:
        """Read the statements from ``begin`` on that have the form last learnt for this kind.

        Returns:
            The beginning of the next statement; 0 if none had that form.
        """
        form = self._forms.get(kind)
        if form is None:
            return 0
        words, length, at, size = self._words, form.length, begin, _FIRST_BLOCK
        while True:
            count = wanted = min(size, (len(words) - at) // length)
            for offset, word in form.same:
                column = words[at + offset : at + count * length : length]
                if column.count(word) < len(column):
                    count = next(index for index, other in enumerate(column) if other != word)
            columns: list[list[int]] = []
            for first, last, letter in form.named:
                columns.append(self._indices(kind, letter, at, (first, last), length, count))
                count = len(columns[-1])
            values = _leading_numbers(kind, words[at + length - 1 : at + count * length : length])
            count = len(values)
            if count:
                self.add(kind, form.wild, [column[:count] for column in columns], values)
            at += count * length
            if count < wanted or not count:
                return at if at > begin else 0
            size = min(size * 4, _LAST_BLOCK)

    def _indices(self, kind: str, letter: str, at: int, span: tuple[int, int], length: int, count: int) -> list[int]:
        """Return the symbol indices of one field in many statements, up to the first that is not a single symbol."""
        words, known = self._words, self._known.setdefault(letter, {})
        columns = [words[at + offset : at + count * length : length] for offset in range(*span)]
        keys: list[Any] = columns[0] if len(columns) == 1 else list(zip(*columns, strict=True))
        found: list[Any] = list(map(known.get, keys))
        if None in found:
            for index, key in enumerate(keys):
                if key not in known:
                    one = self._symbol(kind, letter, at, [key] if isinstance(key, str) else list(key))
                    if one is None:
                        return found[:index]
                    known[key] = one
                found[index] = known[key]
        return found

    def add(self, kind: str, wild: tuple[bool, ...], columns: list[list[int]], values: list[float]) -> None:
        """Collect single entries; store them when the block is full or the form changes."""
        entries = self._kept.get(kind)
        if entries is None or entries.wild != wild or len(entries.values) > _LAST_BLOCK:
            self.flush(kind)
            entries = self._kept[kind] = _Columns(wild, [[] for _ in columns], [])
        for kept, column in zip(entries.columns, columns, strict=True):
            kept.extend(column)
        entries.values.extend(values)

    def flush(self, kind: str) -> None:
        """Store the collected entries of a kind, action by action."""
        entries = self._kept.pop(kind, None)
        if entries is None:
            return
        columns = iter(entries.columns)
        action, *places = [None if wild else np.array(next(columns), dtype=np.int64) for wild in entries.wild]
        values = np.array(entries.values)
        if action is None:
            self._add_entries(kind, None, list(places), values)
            return
        order = np.argsort(action, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(action[order])) + 1):
            mine: list[Places] = [None if place is None else place[part] for place in places]
            self._add_entries(kind, int(action[part[0]]), mine, values[part])

    def _add_entries(
        self, kind: str, action: int | None, places: list[Places], values: npt.NDArray[np.float64]
    ) -> None:
        # Without further symbols all entries are the same one: the last value counts.
        named = any(place is not None for place in places)
        self._store(kind, action, places, values if named else float(values[-1]))


def _leading_numbers(kind: str, words: list[str]) -> list[float]:
    """Return the leading valid numbers of some words; those of T and O are not negative."""
    try:
        values = [] if "_" in "".join(words) else list(map(float, words))
    except ValueError:
        values = []
    if values and math.isfinite(sum(values)) and (kind == "R" or min(values) >= 0):
        return values
    values = []
    for word in words:
        value = number(word)
        if value is None or not math.isfinite(value) or (kind != "R" and value < 0):
            break
        values.append(value)
    return values


class _Form:
    """The form of a statement for a single entry."""

    def __init__(self, words: list[str], named: list[tuple[int, int, str]], wild: tuple[bool, ...]) -> None:
        self.length = len(words)
        self.named = named
        self.wild = wild
        changing = {self.length - 1}.union(*(range(first, last) for first, last, _ in named))
        self.same = [(offset, word) for offset, word in enumerate(words) if offset not in changing]


class _Columns(NamedTuple):
    """Single entries of one form: a column of indices for each field that is not ``*``, and the values."""

    wild: tuple[bool, ...]
    columns: list[list[int]]
    values: list[float]
