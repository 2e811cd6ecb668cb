"""The statements that Cassandra's formats and MADP's have in common: ``T:``, ``O:`` and ``R:`` over named symbols.

Most of a large file repeats a few forms of statement. Once a statement for a single entry has been read word by word,
those of its kind that differ from it only in their symbols and numbers are read in blocks, by the column; 1,000,000
entries take 2 s in place of 9.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt
from scipy import sparse

from mdm.errors import FormatError, ModelError
from mdm.formats.probabilities import Places, Probabilities
from mdm.formats.rewards import Rewards

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.formats.source import Words
    from mdm.models import Space

__all__ = ["Field", "Statements", "number"]

Field = int | list[int] | None
"""A symbol's index, several, or None for all."""

_MOST_ROWS = 50_000_000
_MOST_ERRORS = 5
_FIRST_BLOCK, _LAST_BLOCK = 16, 65_536


def number(word: str) -> float | None:
    """Return the number that a word stands for, or None; ``nan`` and ``inf`` are numbers here, and refused later."""
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


class Statements:
    """Reads statements from words into matrices.

    Args:
        words: The file's words.
        states: The states.
        actions: The (joint) actions.
        observations: The (joint) observations; None in an MDP.
        start: The start distribution, for ``reset``.
        sign: -1 where the file's values are costs.
        field: Reads a field of words as indices of a space.
        colons: Whether a ``:`` stands before every value (MADP) or only between fields (Cassandra).
    """

    def __init__(
        self,
        words: Words,
        *,
        states: Space,
        actions: Space,
        observations: Space | None,
        start: npt.NDArray[np.float64],
        sign: float,
        field: Callable[[int, list[str], Space, str], Field],
        colons: bool,
    ) -> None:
        self._source = words
        self._words = words.words
        self._spaces = {"a": actions, "s": states, "n": states, "o": observations}
        self._start = start
        self._sign = sign
        self._field = field
        self._colons = colons
        self._known: dict[str, dict[Any, int]] = {"a": {}, "s": {}, "n": {}, "o": {}}
        self._forms: dict[str, _Form] = {}
        self._entries: dict[str, _Entries] = {}
        if len(actions) * len(states) > _MOST_ROWS:
            raise ModelError(
                f"{len(actions)} actions in {len(states)} states are too many: at most {_MOST_ROWS} pairs are possible"
            )
        count = 0 if observations is None else len(observations)
        self.transitions = Probabilities(len(actions), len(states), len(states))
        self.observations = Probabilities(len(actions), len(states), count) if count else None
        self.rewards = Rewards(len(actions), len(states), count)

    def fail(self, at: int, message: str) -> NoReturn:
        """Raise a `FormatError` at a word."""
        self._source.fail(at, message)

    def read(self, at: int) -> None:
        """Read statements from a word on to the end.

        Raises:
            FormatError: With the first wrong statements, all at once.
        """
        words = self._words
        errors: list[FormatError] = []
        while at < len(words):
            kind = words[at]
            if kind not in {"T", "O", "R"} or at + 1 == len(words) or words[at + 1] != ":":
                self.fail(at, f"{kind!r} stands where a statement 'T:', 'O:' or 'R:' was expected")
            if kind == "O" and self.observations is None:
                self.fail(at, "an 'O:' statement, but the file declares no observations")
            try:
                at = self._block(kind, at) or self._statement(kind, at + 2)
            except FormatError as error:
                errors.append(error)
                at = self._next_statement(at + 2)
            if len(errors) == _MOST_ERRORS:
                break
        for kind in list(self._entries):
            self._flush(kind)
        if len(errors) == 1:
            raise errors[0]
        if errors:
            rest = "; ".join(f"line {error.line}: {error.message}" for error in errors[1:])
            first = errors[0]
            raise FormatError(f"{first.message}; {rest}", file=first.file, line=first.line, column=first.column)

    def _next_statement(self, at: int) -> int:
        words = self._words
        while at < len(words) and not (words[at] in {"T", "O", "R"} and words[at + 1 : at + 2] == [":"]):
            at += 1
        return at

    def _statement(self, kind: str, at: int) -> int:
        """Read one statement from its first field on; return where the next begins."""
        words = self._words
        begin = at - 2
        letters = {"T": "asn", "O": "ano", "R": "asno"}[kind]
        fields: list[Field] = []
        spans: list[tuple[int, int]] = []
        while True:
            letter = letters[len(fields)]
            end = self._field_end(at)
            if end == at:
                what = {"a": "an action", "o": "an observation"}.get(letter, "a state")
                self.fail(at, f"{what} was expected in this {kind!r} statement")
            space = self._spaces[letter]
            if space is not None:
                fields.append(self._field(at, words[at:end], space, kind))
            elif words[at] != "*":
                break  # in an MDP a colon may stand before the value
            else:
                fields.append(None)
            spans.append((at - begin, end - begin))
            at = end
            if words[at : at + 1] != [":"]:
                break
            at += 1
            if len(fields) == len(letters) or self._values_follow(at, letters[len(fields)]):
                break
        if self._spaces["o"] is None and kind == "R":
            letters, fields = "asn", fields[:3]
        end = self._values(kind, letters, fields, at)
        if len(fields) == len(letters) and not any(isinstance(field, list) for field in fields):
            named = [
                (*span, letter)
                for span, letter, field in zip(spans, letters, fields, strict=False)
                if field is not None
            ]
            self._forms[kind] = _Form(words[begin:end], named, tuple(field is None for field in fields))
        return end

    def _block(self, kind: str, begin: int) -> int:
        """Read the statements from ``begin`` on that have the form of the last single entry of this kind.

        Returns:
            Where the next statement begins; 0 where not one has the form.
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
                columns.append(self._indices(letter, kind, at, first, last, length, count))
                count = len(columns[-1])
            values = self._leading_numbers(kind, words[at + length - 1 : at + count * length : length])
            count = len(values)
            if count:
                self._collect(kind, form.wild, [column[:count] for column in columns], values)
            at += count * length
            if count < wanted or not count:
                return at if at > begin else 0
            size = min(size * 4, _LAST_BLOCK)

    def _indices(self, letter: str, kind: str, at: int, first: int, last: int, length: int, count: int) -> list[int]:
        """Return the symbols' indices in one field of many statements, up to the first that is no single symbol."""
        words, known = self._words, self._known[letter]
        columns = [words[at + offset : at + count * length : length] for offset in range(first, last)]
        keys: list[Any] = columns[0] if len(columns) == 1 else list(zip(*columns, strict=True))
        found: list[Any] = list(map(known.get, keys))
        if None in found:
            space = self._spaces[letter]
            assert space is not None
            for index, key in enumerate(keys):
                if key not in known:
                    try:
                        one = self._field(at, [key] if isinstance(key, str) else list(key), space, kind)
                    except FormatError:
                        one = None  # it is read again by itself, and refused with its place
                    if not isinstance(one, int):
                        return found[:index]
                    known[key] = one
                found[index] = known[key]
        return found

    @staticmethod
    def _leading_numbers(kind: str, words: list[str]) -> list[float]:
        """Return the numbers at the beginning of some words, up to the first that is none or not possible here."""
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

    def _collect(self, kind: str, wild: tuple[bool, ...], columns: list[list[int]], values: list[float]) -> None:
        """Keep single entries until they are many, or a statement of another form comes."""
        entries = self._entries.get(kind)
        if entries is None or entries.wild != wild or len(entries.values) > _LAST_BLOCK:
            self._flush(kind)
            entries = self._entries[kind] = _Entries(wild, [[] for _ in columns], [])
        for kept, column in zip(entries.columns, columns, strict=True):
            kept.extend(column)
        entries.values.extend(values)

    def _flush(self, kind: str) -> None:
        """Store the entries that were kept, action by action."""
        entries = self._entries.pop(kind, None)
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
        # Where nothing but the action is named, they all say the same: the last one counts.
        named = any(place is not None for place in places)
        self._add(kind, action, places, values if named else float(values[-1]))

    def _field_end(self, at: int) -> int:
        if not self._colons:
            return min(at + (self._words[at : at + 1] != [":"]), len(self._words))
        while at < len(self._words) and self._words[at] != ":":
            at += 1
        return at

    def _values_follow(self, at: int, letter: str) -> bool:
        """Whether values, and no further field, follow a colon: in MADP's format each field ends with one."""
        if not self._colons:
            return False
        words = self._words
        end = self._field_end(at)
        if end == len(words) or words[at] in {"uniform", "identity"}:
            return True
        # What precedes the next colon is a field, or values and the first word of the next statement.
        space = self._spaces[letter]
        agents = len(space.factors) if letter == "o" and space is not None else 1
        if words[end - 1] not in {"T", "O", "R"} or end - at == 1:
            return False
        return end - at != agents or (space is not None and len(space) == agents - 1)

    def _values(self, kind: str, letters: str, fields: list[Field], at: int) -> int:
        if kind == "R" and self._spaces["o"] is not None and len(fields) < 2:
            self.fail(at, "an 'R' statement names an action and a state before its values")
        rest = letters[len(fields) :]
        shape = tuple(len(self._spaces[letter]) for letter in rest)  # type: ignore[arg-type]
        words = self._words
        word = words[at] if at < len(words) else None
        value: Any
        if kind != "R" and rest and word in {"uniform", "identity", "reset"}:
            value = self._named(at, str(word), kind, shape)
            at += 1
        else:
            value, at = self._numbers(kind, shape, at)
        self._store(kind, fields, value)
        return at

    def _named(self, at: int, word: str, kind: str, shape: tuple[int, ...]) -> Any:
        if word == "uniform":
            return 1 / shape[-1]
        if word == "identity":
            if len(shape) != 2 or shape[0] != shape[1]:
                self.fail(at, f"'identity' stands for a square matrix, but {kind} needs {' x '.join(map(str, shape))}")
            return sparse.eye_array(shape[0], format="csr")
        if kind != "T" or len(shape) != 1:
            self.fail(at, "'reset' stands for a row of T: the start distribution")
        return self._start

    def _numbers(self, kind: str, shape: tuple[int, ...], at: int) -> tuple[Any, int]:
        words = self._words
        count = math.prod(shape)
        found = words[at : at + count]
        try:
            values = [] if "_" in "".join(found) else list(map(float, found))
        except ValueError:
            values = []
        if len(values) < len(found):
            values = []
            for offset, word in enumerate(found):
                value = number(word)
                if value is None:
                    begins = word in {"T", "O", "R"} and words[at + offset + 1 : at + offset + 2] == [":"]
                    if begins:
                        break
                    self.fail(at + offset, f"{word!r} stands where a number was expected ({count} for this {kind!r})")
                values.append(value)
        if len(values) < count:
            expected = f"{count} numbers ({' x '.join(map(str, shape))})" if shape else "a number"
            self.fail(
                at + max(len(values) - 1, 0),
                f"{expected} for this {kind!r} statement expected, but only {len(values)} given",
            )
        for offset, value in enumerate(values):
            if not math.isfinite(value) or (kind != "R" and value < 0):
                self.fail(at + offset, f"{found[offset]} is no {'reward' if kind == 'R' else 'probability'}")
        return (np.array(values).reshape(shape) if shape else values[0]), at + count

    def _store(self, kind: str, fields: list[Field], value: Any) -> None:
        if isinstance(value, float) and len(fields) == (4 if kind == "R" and self._spaces["o"] is not None else 3):
            wild = tuple(field is None for field in fields)
            single = [[field] for field in fields if isinstance(field, int)]
            if len(single) + sum(wild) == len(fields):
                self._collect(kind, wild, single, [value])
                return
        self._flush(kind)
        places: list[Places] = [np.array(field) if isinstance(field, list) else field for field in fields[1:]]
        self._add(kind, fields[0], places, value)

    def _add(self, kind: str, action: Field, places: list[Places], value: Any) -> None:
        if kind == "R":
            state, next_state, observation = [*places, None, None, None][:3]
            self.rewards.add(action, state, next_state, observation, value * self._sign)
        else:
            stack = self.transitions if kind == "T" else self.observations
            assert stack is not None
            row, column = [*places, None, None][:2]
            stack.add(action, row, column, value)


class _Form:
    """The form of a statement for a single entry.

    Attributes:
        length: In words, the value's at the end included.
        same: The places of the words that every statement of this form has, with these words.
        named: The beginning, end and kind of symbol of each field that names one.
        wild: For each field whether it is ``*``.
    """

    def __init__(self, words: list[str], named: list[tuple[int, int, str]], wild: tuple[bool, ...]) -> None:
        self.length = len(words)
        self.named = named
        self.wild = wild
        changing = {self.length - 1}.union(*(range(first, last) for first, last, _ in named))
        self.same = [(offset, word) for offset, word in enumerate(words) if offset not in changing]


class _Entries(NamedTuple):
    """Single entries of one form: for each field that is not ``*`` a column of indices, and the values."""

    wild: tuple[bool, ...]
    columns: list[list[int]]
    values: list[float]
