"""Probabilities from statements over rows and columns, assembled into one CSR matrix per action.

The last statement for an entry counts; entries without one are 0. Statements are collected, and sorted at the end in
O(n log n) for n given numbers, so that a large model never needs a dense array.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.compressed import csr, is_compressed

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Indices", "Places", "Probabilities"]

Indices = npt.NDArray[np.int64]
Places = int | Indices | None
"""An index, several indices, or None for all."""

_MOST = 50_000_000


class Probabilities:
    """Collects the statements for T or O in file order.

    Args:
        num_actions: A.
        num_rows: S.
        num_columns: S for T, O for observations.
    """

    def __init__(self, num_actions: int, num_rows: int, num_columns: int) -> None:
        self._shape = (num_rows, num_columns)
        self._statements: list[tuple[Places, Places, Any]] = []
        self._by_action: list[list[int]] = [[] for _ in range(num_actions)]

    def add(self, action: int | Sequence[int] | None, row: Places, column: Places, value: Any) -> None:
        """Add a statement; None means all, a sequence several actions.

        ``value`` is a number, a number for each index in ``row`` or ``column``, a row if ``column`` is None, or a
        matrix if both are None.
        """
        for each in self._by_action if action is None else _several(self._by_action, action):
            each.append(len(self._statements))
        self._statements.append((row, column, value))

    def missing(self) -> list[int]:
        """Return the actions without a statement."""
        return [action for action, statements in enumerate(self._by_action) if not statements]

    def matrices(self) -> list[Any]:
        """Return the matrices, one per action; actions with the same statements share one.

        Raises:
            ModelError: If a statement expands to too many numbers.
        """
        done: dict[tuple[int, ...], Any] = {}
        keys = [tuple(statements) for statements in self._by_action]
        for key in keys:
            if key not in done:
                done[key] = self._matrix([self._statements[index] for index in key])
        return [done[key] for key in keys]

    def _matrix(self, statements: list[tuple[Places, Places, Any]]) -> Any:
        num_rows, num_columns = self._shape
        covered = np.full(num_rows, -1)  # the last statement for the whole row
        parts: list[tuple[Indices, Indices, Any]] = []
        turns: list[int] = []
        for turn, (row, column, value) in enumerate(statements):
            if column is None:
                covered[slice(None) if row is None else row] = turn
            if not (np.ndim(value) == 0 and column is None and value == 0):
                parts.append(self._entries(row, column, value))
                turns.append(turn)
        rows = np.concatenate([part[0] for part in parts] or [np.zeros(0, dtype=np.int64)])
        columns = np.concatenate([part[1] for part in parts] or [np.zeros(0, dtype=np.int64)])
        values = np.concatenate([part[2] for part in parts] or [np.zeros(0)])
        counts = np.repeat(np.array(turns, dtype=np.int64), [len(part[0]) for part in parts])
        kept = np.flatnonzero(counts >= covered[rows])
        keys = rows[kept] * num_columns + columns[kept]
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        last = np.append(keys[1:] != keys[:-1], True)[: len(keys)]  # the latest of equal places
        chosen = kept[order[last]]
        chosen = chosen[values[chosen] != 0]
        starts = np.concatenate([[0], np.cumsum(np.bincount(rows[chosen], minlength=num_rows))])
        return csr((values[chosen], columns[chosen], starts), self._shape)

    def _entries(self, row: Places, column: Places, value: Any) -> tuple[Indices, Indices, Any]:
        """Return rows, columns and values of one statement, without most of its zeros."""
        num_rows, num_columns = self._shape
        if is_compressed(value):
            entries = value.tocoo()
            return entries.row.astype(np.int64), entries.col.astype(np.int64), entries.data
        listed = isinstance(row, np.ndarray) or isinstance(column, np.ndarray)
        if np.ndim(value) and not listed:
            return self._given(row, value)
        rows = np.arange(num_rows) if row is None else np.atleast_1d(row)
        columns = np.arange(num_columns) if column is None else np.atleast_1d(column)
        if row is not None and column is not None:
            rows, columns, values = np.broadcast_arrays(rows, columns, value)
            return rows, columns, values.astype(np.float64)
        if len(rows) * len(columns) > _MOST:
            raise ModelError(
                f"a statement for {len(rows)} x {len(columns)} entries exceeds the limit of {_MOST}; give only those "
                f"that are not 0"
            )
        # One of the two is all: combine every index of it with every index and value of the other.
        values = np.asarray(value, dtype=np.float64)
        grid = np.broadcast_to(
            values[:, None] if np.ndim(value) and isinstance(row, np.ndarray) else values, (len(rows), len(columns))
        )
        if isinstance(column, np.ndarray):  # column by column, to keep the order of repeated columns
            return np.tile(rows, len(columns)), np.repeat(columns, len(rows)), grid.T.ravel()
        return np.repeat(rows, len(columns)), np.tile(columns, len(rows)), grid.ravel()

    def _given(self, row: Places, value: Any) -> tuple[Indices, Indices, Any]:
        """Return the non-zero entries of a row or matrix."""
        if row is None and value.ndim == 1:
            columns = np.flatnonzero(value)
            if len(columns) * self._shape[0] > _MOST:
                raise ModelError(f"a row for all {self._shape[0]} states exceeds the limit of {_MOST} entries")
            rows = np.repeat(np.arange(self._shape[0]), len(columns))
            return rows, np.tile(columns, self._shape[0]), np.tile(value[columns], self._shape[0])
        if row is None:
            rows, columns = np.nonzero(value)
            return rows, columns, value[rows, columns]
        columns = np.flatnonzero(value)
        return np.full(len(columns), row, dtype=np.int64), columns, value[columns]


def _several(lists: list[list[int]], action: int | Sequence[int]) -> list[list[int]]:
    return [lists[action]] if isinstance(action, int) else [lists[each] for each in action]
