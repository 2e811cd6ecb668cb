"""Rows: the probabilities of what follows a state and an action, as counted and as the model has them.

Only what the model holds possible is estimated. What has happened and has no probability in the model is told apart,
with its count: averaged in, it would be a small number somewhere, and it is a sensor that is wired wrong, or a model
that lacks an entry.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.estimation.intervals import LEVEL, probability_intervals
from mdm.models.matrices import Matrix, is_compressed

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mdm.estimation.chains import Kind, Stay
    from mdm.models.matrices import Vector
    from mdm.models.mdp import MDP

__all__ = ["Counts", "Row", "counted", "row_of", "support", "transition_rows", "without_staying"]

Counts = dict[tuple[int, int], dict[int, int]]
"""The counts of a model's rows: by action and state, then by what followed."""


class Row(msgspec.Struct, frozen=True):
    """What follows a state and an action.

    Attributes:
        action: The action.
        state: The state: of transitions the one before, of observations the one after the action.
        symbols: The k states, or observations, that the model holds possible.
        model: Their probabilities by the model, k numbers.
        counts: How often each has followed, k numbers; where states are hidden, expected counts.
        estimates: Their probabilities as estimated, k numbers.
        low: The lower ends of the intervals.
        high: The upper ends of the intervals.
        impossible: What has followed though the model says that it cannot, with its count.
    """

    action: int
    state: int
    symbols: npt.NDArray[np.intp]
    model: npt.NDArray[np.float64]
    counts: npt.NDArray[np.float64]
    estimates: npt.NDArray[np.float64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    impossible: tuple[tuple[int, int], ...] = ()

    @property
    def visits(self) -> float:
        """How often something that the model holds possible has followed."""
        return float(self.counts.sum())


def counted(stays: Iterable[Stay]) -> Counts:
    """Return how often each state followed each state and action."""
    counts: Counts = defaultdict(lambda: defaultdict(int))
    for state, action, _, next_state, ended in stays:
        if ended and state is not None and next_state is not None:
            counts[action, state][next_state] += 1
    return {key: dict(row) for key, row in counts.items()}


def support(matrix: Matrix, row: int) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return the places and the values of the entries of a row that are not 0."""
    if is_compressed(matrix):
        part = slice(matrix.indptr[row], matrix.indptr[row + 1])
        places, values = np.asarray(matrix.indices[part], dtype=np.intp), np.asarray(matrix.data[part])
        kept = values > 0
        return places[kept], values[kept]
    places = np.flatnonzero(matrix[row])
    return places, matrix[row, places]


def without_staying(state: int, symbols: npt.NDArray[np.intp], model: Vector) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return the probabilities of the next state, given that it is another one; none where the model never leaves."""
    leaves = symbols != state
    rest = float(model[leaves].sum())
    return symbols[leaves], model[leaves] / rest if rest > 0 else model[leaves]


def row_of(
    action: int,
    state: int,
    symbols: npt.NDArray[np.intp],
    model: Vector,
    followed: Mapping[int, int],
    *,
    level: float = LEVEL,
) -> Row:
    """Return a row from the counts of what followed."""
    counts = np.array([followed.get(symbol, 0) for symbol in symbols.tolist()], dtype=np.float64)
    known = set(symbols.tolist())
    impossible = tuple(sorted((symbol, count) for symbol, count in followed.items() if symbol not in known))
    interval = probability_intervals(counts, level=level) if len(counts) else (counts, counts, counts)
    return Row(action, state, symbols, model, counts, *interval, impossible)


def transition_rows(model: MDP, counts: Counts, kind: Kind, *, level: float = LEVEL) -> tuple[Row, ...]:
    """Return the rows of T that were visited, by action and state.

    Args:
        model: The model; factored ones are flattened.
        counts: See `counted`.
        kind: Of ``jumps`` the rows are those of another state that follows, without staying.
        level: The probability of the intervals.
    """
    flat = model.flatten()
    rows = []
    for (action, state), followed in sorted(counts.items()):
        symbols, probability = support(flat.transition_matrix(action), state)
        if kind == "jumps":
            symbols, probability = without_staying(state, symbols, probability)
        rows.append(row_of(action, state, symbols, probability, followed, level=level))
    return tuple(rows)
