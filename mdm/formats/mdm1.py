"""Policies, Q-tables and rewards of the original MDM: vectors and matrices in boost uBLAS's text format.

A vector is ``[4](0,2,1,0)``, a matrix ``[2,3]((0.25,1,0),(0.75,0,1))``; whitespace is ignored. Neither says what kind
of policy it is: the model's sizes decide, else the numbers.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.formats.source import LARGEST, Source, number
from mdm.formats.target import write_text
from mdm.policies import DeterministicPolicy, QTable, StochasticPolicy

if TYPE_CHECKING:
    from pathlib import Path
    from typing import NoReturn

    from mdm.formats.files import PolicyKind
    from mdm.models import MDP

_HEAD = re.compile(r"\s*\[\s*([^\]\[()]*)\]")
_BRACKETS = re.compile(r"[()]")


def read(path: str | Path) -> npt.NDArray[np.float64]:
    """Read a vector or matrix.

    Raises:
        FormatError: If the text is truncated, not numeric, or not of the size that it declares.
    """
    return _Reader(Source(path)).array()


def write(policy: DeterministicPolicy | StochasticPolicy | QTable | npt.ArrayLike, path: str | Path) -> None:
    """Write a table policy, or a vector or matrix such as rewards; reading it gives the same numbers.

    Raises:
        ValueError: If an array has neither one nor two dimensions.
    """
    if isinstance(policy, DeterministicPolicy):
        text = f"[{policy.num_states}]({','.join(map(str, policy.actions))})"
    elif isinstance(policy, StochasticPolicy):
        text = _text(policy.probabilities)
    else:
        text = _text(policy.values if isinstance(policy, QTable) else np.asarray(policy, dtype=np.float64))
    write_text(path, f"{text}\n")


def _text(array: npt.NDArray[np.float64]) -> str:
    if array.ndim == 1:
        return f"[{len(array)}]({','.join(map(repr, array.tolist()))})"
    if array.ndim != 2:
        raise ValueError(f"uBLAS has vectors and matrices, but this array has {array.ndim} dimensions")
    rows = ",".join(f"({','.join(map(repr, row))})" for row in array.tolist())
    return f"[{array.shape[0]},{array.shape[1]}]({rows})"


class _Reader:
    def __init__(self, source: Source) -> None:
        self._source = source

    def _fail(self, at: int, message: str) -> NoReturn:
        line, column = self._source.place(at)
        self._source.fail(message, line=line, column=column)

    def array(self) -> npt.NDArray[np.float64]:
        text = self._source.text
        head = _HEAD.match(text)
        if head is None:
            self._fail(0, "a size in brackets was expected, such as '[12]' for a vector or '[2,3]' for a matrix")
        sizes = [size.strip() for size in head[1].split(",")]
        if len(sizes) > 2 or not all(size.isdecimal() and 0 < int(size) <= 10**9 for size in sizes):
            size = " ".join(head[1].split())
            self._fail(
                head.start(1),
                f"'[{size[:40]}]' is not the size of a vector or matrix: one or two numbers were expected",
            )
        rows = self._rows(text, head.end(), depth=len(sizes))
        count = int(sizes[0])
        if len(sizes) == 1:
            return np.array(self._numbers(*rows[0], count, "vector"))
        if len(rows) != count:
            self._fail(head.start(1), f"{count} rows are declared, but {len(rows)} are given")
        return np.array([self._numbers(*row, int(sizes[1]), f"row {index}") for index, row in enumerate(rows)])

    def _rows(self, text: str, at: int, *, depth: int) -> list[tuple[int, str]]:
        """Return the positions and contents of the innermost brackets."""
        rows: list[tuple[int, str]] = []
        level = 0
        begin = last = at
        for bracket in _BRACKETS.finditer(text, at):
            between = text[last : bracket.start()].strip()
            if bracket[0] == "(":
                if level == depth or between not in ({"", ","} if level == 1 else {""}):
                    self._fail(bracket.start(), "a number was expected, not '('")
                level += 1
                begin = bracket.end()
            else:
                if level == depth:
                    rows.append((begin, text[begin : bracket.start()]))
                elif between not in {"", ","}:
                    self._fail(last, f"')' was expected, not {between[:20]!r}")
                level -= 1
                if level == 0:
                    self._end(text, bracket.end())
                    return rows
            last = bracket.end()
        head = "".join(text[:at].split())
        return self._fail(len(text) - 1, f"the text ends before the brackets of {head} are closed")

    def _end(self, text: str, at: int) -> None:
        rest = text[at:].strip()
        if rest:
            self._fail(at + text[at:].index(rest[0]), f"the end was expected, not {rest[:20]!r}")

    def _numbers(self, at: int, text: str, count: int, what: str) -> list[float]:
        words = text.split(",")
        if len(words) > 1 and not words[-1].strip():
            words.pop()  # some writers leave a trailing comma
        numbers: list[float] = []
        for word in words:
            value = number(word)
            if value is None:
                self._fail(at, f"{word.strip()[:40]!r} in the {what} is not a number")
            numbers.append(value)
            at += len(word) + 1
        if len(numbers) != count:
            self._fail(at - 1, f"{count} numbers are declared, but {len(numbers)} are given in the {what}")
        return numbers


def table(
    source: Source,
    array: npt.NDArray[np.float64],
    model: MDP | None,
    kind: PolicyKind | None,
    seed: int | None,
) -> DeterministicPolicy | QTable | StochasticPolicy:
    """Make a policy of a vector or matrix.

    Args:
        source: The file, for errors.
        array: A vector, an action per state; or a matrix of probabilities (actions x states) or values (states x
            actions).
        model: The policy's model, if known.
        kind: The kind of table; None to find out.
        seed: Seed of a stochastic policy's draws.

    Raises:
        FormatError: If a vector's entry is not an action, or the array does not fit the kind.
        ModelError: If a matrix is not a policy.
    """
    if kind is not None and (kind == "table") != (array.ndim == 1):
        held = "a vector of actions" if array.ndim == 1 else "a matrix"
        source.fail(f"the file holds {held}, not kind={kind!r}")
    if array.ndim == 1:
        return _vector(source, array, None if model is None else len(model.action_space))
    if kind is None:
        kind = _matrix_kind(array, model)
    if kind == "q":
        return QTable(array)
    try:
        return StochasticPolicy(array, seed=seed)
    except ModelError as error:
        raise ModelError(f"{error}; if the matrix is a Q-table (states x actions), say kind='q'") from None


def _matrix_kind(array: npt.NDArray[np.float64], model: MDP | None) -> PolicyKind:
    """Return the kind of a matrix, from its shape if the model decides, else from its numbers."""
    if model is not None and array.shape[0] != array.shape[1]:
        sizes = len(model.action_space), len(model.state_space)
        if array.shape in {sizes, sizes[::-1]}:
            return "stochastic" if array.shape == sizes else "q"
    stochastic = bool((array >= 0).all() and (np.abs(array.sum(axis=0) - 1) <= 1e-4).all())
    nearly = bool((array >= 0).all() and (array <= 1).all() and array.sum(axis=0).max() > 1)
    # Probabilities that do not sum to 1 are more likely a broken policy than a Q-table.
    return "stochastic" if stochastic or nearly else "q"


def _vector(source: Source, array: npt.NDArray[np.float64], num_actions: int | None) -> DeterministicPolicy:
    for state, action in enumerate(array.tolist()):
        if not (0 <= action <= LARGEST and action.is_integer()):
            source.fail(f"the action for state {state} is {action:g}, not an index from 0 on")
        if num_actions is not None and action >= num_actions:
            source.fail(f"the action for state {state} is {action:g}, but the model has actions 0 to {num_actions - 1}")
    return DeterministicPolicy(array.astype(int).tolist(), num_actions)
