"""Statements ``T:``, ``O:`` and ``R:``, common to Cassandra's formats and MADP's.

Large files mostly repeat a few forms of statement. After one statement of a form has been parsed word by word, those
that follow it with other symbols and numbers are parsed column by column: 1,000,000 entries take 2 s instead of 9 s.
Words of other programs' dialects and misspelt sections are told as what they are.
"""

from __future__ import annotations

import difflib
import math
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats.cassandra.parameters import Places, Probabilities, Rewards
from mdm.formats.source import number
from mdm.models.availability import HINT
from mdm.models.matrices import csr_identity
from mdm.models.validation import report

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from mdm.formats.source import Words
    from mdm.models import Space
    from mdm.models.matrices import RowError

Field = int | list[int] | None
"""An index, several indices, or None for all."""

_MOST_ROWS = 50_000_000
_MOST_ERRORS = 5
_FIRST_BLOCK, _LAST_BLOCK = 16, 65_536
_DIALECTS = {
    "E": "'E:' names end states in a dialect of ZMDP and others, which is not read: take the line out, and let these "
    "states lead to themselves",
    "atom": "'atom' names the observations or states of an atomic proposition, for temporal logic, in a dialect that "
    "is not read: take the line out, and say what is wanted by rewards (R)",
    "prio": "'prio' gives states a priority, for parity objectives, in a dialect that is not read: take the line out, "
    "and say what is wanted by rewards (R)",
    "partitionSizes": "'partitionSizes:' divides states or observations among agents, in a dialect that is not read: "
    "take it out, with its lines",
}
_NUMBERED = {"atom", "prio"}
"""Words that a number follows, before the colon."""


class Statements:
    """Reads statements and collects T, O and R.

    Args:
        words: The file's words.
        states: The states.
        actions: The (joint) actions.
        observations: The (joint) observations; None in an MDP.
        start: The start distribution, for ``reset``.
        sign: -1 if the file's values are costs.
        field: Parses the words of a field as indices of a space; its last argument is the kind of statement and the
            field's letter, for `unknown`.
        colons: Whether a ``:`` precedes every value (MADP) or only separates fields (Cassandra).
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
        self._entries = Entries(words.words, words.report, self._symbol, self._add)
        if len(actions) * len(states) > _MOST_ROWS:
            raise ModelError(f"{len(actions)} actions in {len(states)} states exceed the limit of {_MOST_ROWS} pairs")
        count = 0 if observations is None else len(observations)
        self.transitions = Probabilities(len(actions), len(states), len(states))
        self.observations = Probabilities(len(actions), len(states), count) if count else None
        self.rewards = Rewards(len(actions), len(states), count)

    def fail(self, at: int, message: str) -> NoReturn:
        """Raise a `FormatError` at a word."""
        self._source.fail(at, message)

    def read(self, at: int) -> None:
        """Read all statements from a word on.

        Raises:
            FormatError: With the first few wrong statements at once.
        """
        words = self._words
        errors: list[FormatError] = []
        while at < len(words):
            self._source.report(at)
            kind = words[at]
            if kind not in {"T", "O", "R"} or at + 1 == len(words) or words[at + 1] != ":":
                self.fail(at, foreign(kind) or f"a statement 'T:', 'O:' or 'R:' was expected, not {kind!r}")
            if kind == "O" and self.observations is None:
                self.fail(at, "an 'O:' statement, but the file declares no observations")
            try:
                at = self._entries.read(kind, at) or self._statement(kind, at + 2)
            except FormatError as error:
                if not report(str(error)):
                    errors.append(error)
                at = self._next_statement(at + 2)
            if len(errors) == _MOST_ERRORS:
                break
        for kind in "TOR":
            self._entries.flush(kind)
        if len(errors) == 1:
            raise errors[0]
        if errors:
            rest = "; ".join(f"line {error.line}: {error.message}" for error in errors[1:])
            first = errors[0]
            raise FormatError(f"{first.message}; {rest}", file=first.file, line=first.line, column=first.column)
        self._source.report(len(words))

    def refuse(self, error: RowError) -> NoReturn:
        """Raise a `FormatError` where a row that is not a distribution begins, or the last statement for it does.

        Of a row that no statement is for it is at the last one for its action.
        """
        words, kind = self._words, error.what
        columns = len(self._spaces["n" if kind == "T" else "o"] or ())
        found = block = None
        for at in (i for i, word in enumerate(words[:-1]) if word == kind and words[i + 1] == ":"):
            end = self._field_end(at + 2)
            if not self._names_symbol(kind, "a", at + 2, end, error.action):
                continue
            block, values = at, end + (words[end : end + 1] == [":"])
            if values > end and not self._values_follow(values, "s"):
                if self._names_symbol(kind, "s", values, self._field_end(values), error.row):
                    found = at
            else:
                listed = values < len(words) and number(words[values]) is not None
                found = values + error.row * columns if listed else at
        place = found if found is not None else block
        self.fail(len(words) - 1 if place is None else place, str(error))

    def _names_symbol(self, kind: str, letter: str, begin: int, end: int, symbol: int) -> bool:
        """Whether a field names a symbol."""
        space = self._spaces[letter]
        assert space is not None
        try:
            field = self._field(begin, self._words[begin:end], space, kind + letter)
        except FormatError:  # which is a problem of its own
            return False
        return field is None or field == symbol or (isinstance(field, list) and symbol in field)

    def _next_statement(self, at: int) -> int:
        words = self._words
        while at < len(words) and not (words[at] in {"T", "O", "R"} and words[at + 1 : at + 2] == [":"]):
            at += 1
        return at

    def _statement(self, kind: str, at: int) -> int:
        """Read one statement from its first field on; return the beginning of the next."""
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
                fields.append(self._field(at, words[at:end], space, kind + letter))
            elif words[at] != "*":
                break  # in an MDP a colon may precede the value
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
            self._entries.learn(kind, words[begin:end], named, tuple(field is None for field in fields))
        return end

    def _symbol(self, kind: str, letter: str, at: int, words: list[str]) -> int | None:
        """Return the index of the single symbol that some words name, else None."""
        space = self._spaces[letter]
        assert space is not None
        try:
            field = self._field(at, words, space, kind + letter)
        except FormatError:
            return None  # the statement is then read by itself, which reports the place
        return field if isinstance(field, int) else None

    def _field_end(self, at: int) -> int:
        if not self._colons:
            return min(at + (self._words[at : at + 1] != [":"]), len(self._words))
        while at < len(self._words) and self._words[at] != ":":
            at += 1
        return at

    def _values_follow(self, at: int, letter: str) -> bool:
        """Whether values rather than another field follow a colon; in MADP's format every field ends with one."""
        if not self._colons:
            return False
        words = self._words
        end = self._field_end(at)
        if end == len(words) or words[at] in {"uniform", "identity"}:
            return True
        # Before the next colon is either a field, or values and the first word of the next statement.
        space = self._spaces[letter]
        agents = len(space.factors) if letter == "o" and space is not None else 1
        if words[end - 1] not in {"T", "O", "R"} or end - at == 1:
            return False
        return end - at != agents or (space is not None and len(space) == agents - 1)

    def _values(self, kind: str, letters: str, fields: list[Field], at: int) -> int:
        if kind == "R" and self._spaces["o"] is not None and len(fields) < 2:
            self.fail(at, "an action and a state were expected before the values of this 'R' statement")
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
                self.fail(at, f"'identity' is a square matrix, but {kind} needs {' x '.join(map(str, shape))}")
            return csr_identity(shape[0])
        if kind != "T" or len(shape) != 1:
            self.fail(at, "'reset' is a row of T, the start distribution, and nothing else")
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
                    expected = f"a number was expected ({count} for this {kind!r}), not {word!r}"
                    self.fail(at + offset, foreign(word) or expected)
                values.append(value)
        if len(values) < count:
            expected = f"{count} numbers ({' x '.join(map(str, shape))})" if shape else "a number"
            self.fail(
                at + max(len(values) - 1, 0),
                f"{expected} for this {kind!r} statement expected, but only {len(values)} given",
            )
        for offset, value in enumerate(values):
            if not math.isfinite(value) or (kind != "R" and value < 0):
                hint = f": {HINT}" if kind == "R" and math.isinf(value) else ""
                self.fail(at + offset, f"{found[offset]} is not a {'reward' if kind == 'R' else 'probability'}{hint}")
        return (np.array(values).reshape(shape) if shape else values[0]), at + count

    def _store(self, kind: str, fields: list[Field], value: Any) -> None:
        if isinstance(value, float) and len(fields) == (4 if kind == "R" and self._spaces["o"] is not None else 3):
            wild = tuple(field is None for field in fields)
            single = [[field] for field in fields if isinstance(field, int)]
            if len(single) + sum(wild) == len(fields):
                self._entries.add(kind, wild, single, [value])
                return
        self._entries.flush(kind)
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


def unknown(word: str, where: str, error: ModelError) -> str:
    """Return in words that no symbol has a name, and which is closest; see `Statements` for where."""
    noun = {"a": "action", "o": "observation"}.get(where[1], "state")
    hint = str(error).partition("; ")[2]
    return f"{word!r} in this {where[0]!r} statement is no {noun}; {hint.replace('symbols', f'{noun}s')}"


def check_commas(names: Iterable[str], what: str) -> str | None:
    """Return in words that names have commas at their ends; None where none has."""
    found = [name for name in names if name != name.strip(",")]
    if not found:
        return None
    return f"{', '.join(map(repr, found[:5]))} among the {what}: blanks separate names, and a comma is part of one"


class Entries:
    """Reads and collects single entries of the kinds ``T``, ``O`` and ``R``.

    Args:
        words: The file's words.
        report: Called with the word up to which statements have been read.
        symbol: Returns the index of the single symbol that some words name, else None. Its arguments are the kind of
            statement, the field's letter, the place in the file, and the words.
        store: Called in file order with the entries' kind, action, further symbols and values.
    """

    def __init__(
        self,
        words: list[str],
        report: Callable[[int], object],
        symbol: Callable[[str, str, int, list[str]], int | None],
        store: Callable[[str, int | None, list[Places], Any], None],
    ) -> None:
        self._words = words
        self._report = report
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
            self._report(at)
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
        if any(place is not None for place in places):
            self._store(kind, action, places, values)
            return
        for value in values[-2:]:  # all are the same entry: the last one counts, the one before shows that it is again
            self._store(kind, action, places, float(value))


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


def foreign(word: str, sections: Iterable[str] = ()) -> str | None:
    """Return the error of a word where a section or statement might begin; None where nothing is known of it.

    Args:
        word: The word.
        sections: The names of sections, for misspelt words.
    """
    if word in _DIALECTS:
        return _DIALECTS[word]
    close = difflib.get_close_matches(word, list(sections), n=1)
    return f"there is no section {word!r}; did you mean {close[0]!r}?" if close and word not in close else None


def begins_foreign(words: Sequence[str], at: int) -> bool:
    """Whether a line of another dialect or a misspelt section may begin at a word: a colon ends its head."""
    numbered = words[at] in _NUMBERED and words[at + 1 : at + 2] != [":"]
    return words[at + 1 + numbered : at + 2 + numbered] == [":"]
