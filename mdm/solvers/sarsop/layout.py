"""A POMDP as the arrays that SARSOP works on: sparse rows, and states in blocks that observations tell apart.

Where part of the state is seen (mixed observability), beliefs never leave the states of one value of it. Such states
make a block; states are renumbered so that a block's lie side by side, and vectors are over one block each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.models.compressed import csr, is_compressed
from mdm.models.factored.mixed import MixedPOMDP

if TYPE_CHECKING:
    from mdm.models import POMDP
    from mdm.models.matrices import Vector

__all__ = ["Layout", "layout_of"]

Integers = npt.NDArray[np.int32]
Long = npt.NDArray[np.int64]


class Layout(NamedTuple):
    """A model's numbers; the row of action a and state s is ``a * S + s``.

    Attributes:
        discount: In (0, 1).
        rewards: A x S.
        rows: Where each row of T begins.
        next_states: The columns of T's entries.
        chances: T's entries.
        seen_rows: Where each row of O begins.
        symbols: The columns of O's entries.
        likelihoods: O's entries.
        block: Each state's block.
        first_state: Where each block begins, and the end of the last.
    """

    discount: float
    rewards: npt.NDArray[np.float64]
    rows: Long
    next_states: Integers
    chances: npt.NDArray[np.float64]
    seen_rows: Long
    symbols: Integers
    likelihoods: npt.NDArray[np.float64]
    block: Integers
    first_state: Long


def layout_of(model: POMDP) -> tuple[Layout, npt.NDArray[np.intp]]:
    """Return a model's layout, and the model's states in the layout's order."""
    blocks = model.layout if isinstance(model, MixedPOMDP) else np.arange(len(model.state_space))[None, :]
    order = blocks.ravel()
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    actions = range(len(model.action_space))
    rows, next_states, chances = _stacked([model.transition_matrix(a) for a in actions], order, place)
    seen_rows, symbols, likelihoods = _stacked([model.observation_matrix(a) for a in actions], order, None)
    count, width = blocks.shape
    return Layout(
        model.discount,
        np.ascontiguousarray(model.rewards[order].T),
        rows,
        next_states,
        chances,
        seen_rows,
        symbols,
        likelihoods,
        np.repeat(np.arange(count, dtype=np.int32), width),
        np.arange(count + 1, dtype=np.int64) * width,
    ), order


def _stacked(
    matrices: list[Any], order: npt.NDArray[np.intp], place: npt.NDArray[np.intp] | None
) -> tuple[Long, Integers, Vector]:
    """Return matrices below each other, as one in CSR, with rows and, with ``place``, columns in another order."""
    starts, columns, data = [np.zeros(1, dtype=np.int64)], [], []
    for matrix in matrices:
        moved = (matrix if is_compressed(matrix) else csr(matrix))[order]
        starts.append(starts[-1][-1] + moved.indptr[1:].astype(np.int64))
        columns.append((moved.indices if place is None else place[moved.indices]).astype(np.int32))
        data.append(moved.data)
    return np.concatenate(starts), np.concatenate(columns), np.concatenate(data)
