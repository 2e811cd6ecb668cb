"""Statements ``T:``, ``O:`` and ``R:``, common to Cassandra's formats and MADP's."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats.cassandra.dialects import foreign
from mdm.formats.cassandra.entries import Entries
from mdm.formats.cassandra.probabilities import Places, Probabilities
from mdm.formats.cassandra.rewards import Rewards
from mdm.formats.source import number
from mdm.models.compressed import csr_identity
from mdm.models.validation import report

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.formats.source import Words
    from mdm.models import Space
    from mdm.models.matrices import RowError

__all__ = ["Field", "Statements"]

Field = int | list[int] | None
"""An index, several indices, or None for all."""

_MOST_ROWS = 50_000_000
_MOST_ERRORS = 5


class Statements:
    """Reads statements and collects T, O and R.

    Args:
        words: The file's words.
        states: The states.
        actions: The (joint) actions.
        observations: The (joint) observations; None in an MDP.
        start: The start distribution, for ``reset``.
        sign: -1 if the file's values are costs.
        field: Parses the words of a field as indices of a space.
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
        self._entries = Entries(words.words, self._symbol, self._add)
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

    def refuse(self, error: RowError) -> NoReturn:
        """Raise a `FormatError` at the last statement for a row that is not a distribution, or for its action."""
        words, kind = self._words, error.what
        found = block = None
        for at in (i for i, word in enumerate(words[:-1]) if word == kind and words[i + 1] == ":"):
            end = self._field_end(at + 2)
            of_action = self._names_symbol(kind, "a", at + 2, end, error.action)
            names_row = words[end : end + 1] == [":"] and not self._values_follow(end + 1, "s")
            if of_action:
                block = at
                if not names_row or self._names_symbol(kind, "s", end + 1, self._field_end(end + 1), error.row):
                    found = at
        place = found if found is not None else block
        self.fail(len(words) - 1 if place is None else place, str(error))

    def _names_symbol(self, kind: str, letter: str, begin: int, end: int, symbol: int) -> bool:
        """Whether a field names a symbol."""
        space = self._spaces[letter]
        assert space is not None
        field = self._field(begin, self._words[begin:end], space, kind)
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
                fields.append(self._field(at, words[at:end], space, kind))
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
            field = self._field(at, words, space, kind)
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
                self.fail(at + offset, f"{found[offset]} is not a {'reward' if kind == 'R' else 'probability'}")
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
