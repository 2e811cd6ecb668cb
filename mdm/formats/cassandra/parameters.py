"""The numbers of statements: T and O as one CSR matrix per action, and rewards reduced to their expectation R(s, a).

The last statement for an entry counts; entries without one are 0. Statements are collected, and sorted at the end in
O(n log n) for n given numbers, so that a large model never needs a dense array.

R(s, a) is the sum over s' of T(s' | s, a) times the sum over o of O(o | a, s') R(a, s, s', o). The cost is the number
of non-zeros of T, times O if rewards depend on the observation; states are then processed in blocks.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.matrices import csr, is_compressed

if TYPE_CHECKING:
    from collections.abc import Sequence

Indices = npt.NDArray[np.int64]
Places = int | Indices | None
"""An index, several indices, or None for all."""

_MOST = 50_000_000
_BLOCK = 5_000_000
_MANY = 1_000_000


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


_Statement = tuple["Places", "Places", "Places", Any]


class Rewards:
    """Collects reward statements in file order.

    Args:
        num_actions: A.
        num_states: S.
        num_observations: O; 0 for an MDP.
    """

    def __init__(self, num_actions: int, num_states: int, num_observations: int) -> None:
        self._num_states = num_states
        self._num_observations = num_observations
        self._by_action: list[list[_Statement]] = [[] for _ in range(num_actions)]
        self._for_all: set[int] = set()
        """The identities of statements for all actions, which those for one may well follow."""

    def add(
        self, action: int | Sequence[int] | None, state: Places, next_state: Places, observation: Places, value: Any
    ) -> None:
        """Add a statement; None means all, a sequence several actions.

        ``value`` is a number; a number for each index in the other arguments; a row over the observations (next states
        in an MDP) if ``observation`` is None; or a matrix over next states and observations (states and next states in
        an MDP) if ``next_state`` is None too.
        """
        statement = (state, next_state, observation, value)
        if action is None:
            self._for_all.add(id(statement))
        for each in range(len(self._by_action)) if action is None else [action] if isinstance(action, int) else action:
            self._by_action[each].append(statement)

    def expected(self, transitions: Sequence[Any], observations: Sequence[Any] | None) -> npt.NDArray[np.float64]:
        """Return R(s, a), an S x A array, given T and O as one CSR matrix per action."""
        result = np.zeros((self._num_states, len(self._by_action)))
        for action, statements in enumerate(self._by_action):
            if all(n is None and o is None and not _is_row(s, n, o, value) for s, n, o, value in statements):
                for state, _, _, value in statements:
                    result[slice(None) if state is None else state, action] = value
            else:
                matrix = None if observations is None else observations[action]
                result[:, action] = self._action(statements, transitions[action], matrix)
        return result

    @property
    def finer(self) -> bool:
        """Whether rewards depend on next states or observations; in large models, whether a statement names any."""
        named = any(
            n is not None or o is not None or (_is_row(s, n, o, value) and np.ptp(value) != 0)
            for statements in self._by_action
            for s, n, o, value in statements
        )
        array = self.array(_MANY) if named else None
        if array is None:
            return named
        outcomes = array.reshape(*array.shape[:2], -1)
        return bool((outcomes != outcomes[..., :1]).any())

    def overwritten(self) -> tuple[int, int] | None:
        """Return an action and a state of which a statement is lost to a later one that names less; None if none is.

        The later ones that are looked at name one symbol besides the action, or none.
        """
        for action, statements in enumerate(self._by_action):
            for after, (*general, value) in enumerate(statements):
                named = [axis for axis, place in enumerate(general) if place is not None]
                if np.ndim(value) > 1 or len(named) > 1 or (np.ndim(value) == 1 and not named):
                    continue
                for *places, before in statements[:after]:
                    if np.ndim(before) > 1 or sum(place is not None for place in places) <= len(named):
                        continue
                    lost = np.ones(np.size(before), dtype=bool)
                    for axis in named:
                        narrow: Any = places[axis]
                        wide: Any = general[axis]
                        lost &= False if narrow is None else np.isin(narrow, wide)
                    state = places[0]
                    if lost.any() and state is not None:
                        return action, int(np.broadcast_to(state, lost.shape)[lost.argmax()])
        return None

    def repeated(self) -> tuple[int, int | None] | None:
        """Return an action and a state (None for all) of which one entry is given twice; None where none is."""
        for action, statements in enumerate(self._by_action):
            alike: dict[Any, list[Indices]] = {}
            for statement in statements:
                *places, value = statement
                named = [np.atleast_1d(place) for place in places if place is not None] or [np.zeros(1, np.int64)]
                size = np.ndim(value) if _is_row(*statement) else 0
                kind = tuple(place is None for place in places), size, id(statement) in self._for_all
                alike.setdefault(kind, []).append(np.stack(np.broadcast_arrays(*named), axis=1))
            for (wild, *_), blocks in alike.items():
                entries, counts = np.unique(np.concatenate(blocks), axis=0, return_counts=True)
                if counts.max() > 1:
                    return action, None if wild[0] else int(entries[counts.argmax(), 0])
        return None

    def at(self, action: int, state: int, next_state: int, observation: int | None) -> float:
        """Return R(a, s, s', o), from the last statement for it.

        Raises:
            ModelError: If it depends on the observation and none is given.
        """
        for statement in reversed(self._by_action[action]):
            value = self._reward(statement, state, next_state, observation)
            if value is not None:
                return value
        return 0.0

    def _reward(self, statement: _Statement, state: int, next_state: int, observation: int | None) -> float | None:
        """Return a statement's reward for an outcome; None if it is not for that outcome."""
        *places, value = statement
        over_observations = self._num_observations > 0 and (places[2] is not None or _is_row(*statement))
        if over_observations and observation is None:
            raise ModelError("the reward depends on the observation: name one")
        outcome = (state, next_state, observation)
        if _is_row(*statement):
            last = outcome if self._num_observations else outcome[:2]
            if not all(place is None or place == at for place, at in zip(places, outcome, strict=True)):
                return None
            return float(value[last[-np.ndim(value) :]])
        count = max((len(place) for place in places if isinstance(place, np.ndarray)), default=1)
        covers = np.ones(count, dtype=bool)
        for place, at in zip(places, outcome, strict=True):
            if place is not None:
                covers &= place == at
        found = np.flatnonzero(covers)
        if not len(found):
            return None
        return float(value[found[-1]] if np.ndim(value) else value)

    def array(self, largest: int) -> npt.NDArray[np.float64] | None:
        """Return the rewards as A x S x S' x O (A x S x S' in an MDP); None if that exceeds ``largest`` numbers."""
        shape = (self._num_states, self._num_states, *([self._num_observations] if self._num_observations else []))
        if len(self._by_action) * math.prod(shape) > largest:
            return None
        result = np.zeros((len(self._by_action), *shape))
        for rewards, statements in zip(result, self._by_action, strict=True):
            for *places, value in statements:
                chosen = [slice(None) if place is None else place for place in places[: len(shape)]]
                listed = [place for place in places if isinstance(place, np.ndarray)]
                if not listed or np.ndim(value) == 0:
                    rewards[tuple(chosen)] = value
                    continue
                for index in range(len(listed[0])):  # one by one: the last of equal places counts
                    one = [place[index] if isinstance(place, np.ndarray) else place for place in chosen]
                    rewards[tuple(one)] = value[index]
        return result

    def _action(self, statements: list[_Statement], transition: Any, observation: Any) -> npt.NDArray[np.float64]:
        over_observations = observation is not None and any(
            o is not None or _is_row(s, n, o, value) for s, n, o, value in statements
        )
        starts = transition.indptr.astype(np.int64)
        width = self._num_observations if over_observations else 1
        result = np.zeros(self._num_states)
        first = 0
        while first < self._num_states:
            last = int(np.searchsorted(starts, starts[first] + _BLOCK // width, side="right")) - 1
            last = min(max(last, first + 1), self._num_states)
            block = _Block(transition, starts, first, last, width if over_observations else 0)
            for statement in statements:
                block.apply(*statement)
            rewards = block.rewards
            if over_observations:
                chances = observation[block.next_states].toarray()
                rewards = np.einsum("no,no->n", chances, rewards)
            weights = transition.data[starts[first] : starts[last]] * rewards
            result[first:last] = np.bincount(block.states - first, weights, minlength=last - first)
            first = last
        return result


class _Block:
    """Rewards of one action for the transitions from a range of states, with or without an axis of observations."""

    def __init__(self, transition: Any, starts: Indices, first: int, last: int, width: int) -> None:
        self._first, self._last = first, last
        self._num_states = transition.shape[1]
        self._starts = starts[first : last + 1] - starts[first]
        self.states = np.repeat(np.arange(first, last), np.diff(self._starts))
        self.next_states = transition.indices[starts[first] : starts[last]].astype(np.int64)
        self._keys = self.states * self._num_states + self.next_states
        self._width = width
        self.rewards = np.zeros((len(self.states), width) if width else len(self.states))

    def apply(self, state: Places, next_state: Places, observation: Places, value: Any) -> None:
        """Set the rewards that a statement is for."""
        if isinstance(state, int) and not self._first <= state < self._last:
            return
        if _is_row(state, next_state, observation, value):
            where, _ = self._where(state, next_state)
            if np.ndim(value) == 2:
                if self._width:
                    self.rewards[where] = value[self.next_states[where]]
                else:
                    self.rewards[where] = value[self.states[where], self.next_states[where]]
            else:
                self.rewards[where] = value if self._width else value[self.next_states[where]]
        elif isinstance(observation, np.ndarray):
            for symbol in np.unique(observation):
                chosen = observation == symbol
                self.apply(
                    state[chosen] if isinstance(state, np.ndarray) else state,
                    next_state[chosen] if isinstance(next_state, np.ndarray) else next_state,
                    int(symbol),
                    _parallel(state, next_state, value[chosen] if np.ndim(value) else value),
                )
        else:
            where, source = self._where(state, next_state)
            values = value[source] if np.ndim(value) else value
            if not self._width:
                self.rewards[where] = values
            elif observation is None:
                self.rewards[where] = values[:, None] if np.ndim(values) else values
            else:
                self.rewards[where, observation] = values

    def _where(self, state: Places, next_state: Places) -> tuple[Any, Any]:
        """Return the transitions between the given states, and for each the position of its states among them."""
        if state is None and next_state is None:
            return slice(None), 0
        if next_state is None and isinstance(state, int):
            begin, end = self._starts[state - self._first], self._starts[state - self._first + 1]
            return slice(int(begin), int(end)), 0
        if state is None or next_state is None:
            wanted, present = (next_state, self.next_states) if state is None else (state, self.states)
            assert wanted is not None
            wanted = np.atleast_1d(wanted)
            latest = np.full(self._num_states, -1)
            latest[wanted] = np.arange(len(wanted))
            source = latest[present]
            where = np.flatnonzero(source >= 0)
            return where, source[where]
        keys = np.atleast_1d(np.asarray(state * self._num_states + next_state))
        if not len(self._keys):
            return slice(0), slice(0)
        at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        found = np.flatnonzero(self._keys[at] == keys)
        return at[found], found


def _is_row(state: Places, next_state: Places, observation: Places, value: Any) -> bool:
    """Whether a value is a row or matrix over the axes not named, rather than a number for each named index."""
    return np.ndim(value) > 0 and not any(isinstance(p, np.ndarray) for p in (state, next_state, observation))


def _parallel(state: Places, next_state: Places, value: Any) -> Any:
    """Return the values for the named states; only the last one if no states are named."""
    named = isinstance(state, np.ndarray) or isinstance(next_state, np.ndarray)
    return value[-1] if np.ndim(value) and not named else value
