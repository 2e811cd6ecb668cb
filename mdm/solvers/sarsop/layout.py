"""The dynamics of SARSOP, with the states in blocks that observations tell apart.

Where part of the state is seen (mixed observability), beliefs never leave the states of one value of it. Such states
make a block; states are renumbered so that a block's lie side by side, and vectors are over one block each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.models.dynamics import Dynamics, Indices, Rows
from mdm.models.factored.mixed import MixedPOMDP

if TYPE_CHECKING:
    from mdm.models import POMDP

__all__ = ["Layout", "layout_of"]

Integers = npt.NDArray[np.int32]
Long = npt.NDArray[np.int64]


class Layout(NamedTuple):
    """A model's numbers.

    Attributes:
        discount: In (0, 1).
        rewards: A x S.
        transitions: T.
        observations: O.
        block: Each state's block.
        first_state: Where each block begins, and the end of the last.
    """

    discount: float
    rewards: npt.NDArray[np.float64]
    transitions: Rows
    observations: Rows
    block: Integers
    first_state: Long


def layout_of(model: POMDP, dynamics: Dynamics) -> tuple[Layout, Indices]:
    """Return a model's layout, and the model's states in the layout's order."""
    blocks = model.layout if isinstance(model, MixedPOMDP) else np.arange(dynamics.num_states)[None, :]
    order: Indices = blocks.ravel()
    transitions, observations = dynamics.transitions, dynamics.observations
    if len(blocks) > 1:
        place = np.empty(len(order), dtype=np.uint32)
        place[order] = np.arange(len(order))
        transitions = _renumbered(transitions, order, len(order))
        transitions = transitions._replace(columns=place[transitions.columns])
        observations = _renumbered(observations, order, dynamics.num_observations)
    count, width = blocks.shape
    return Layout(
        dynamics.discount,
        np.ascontiguousarray(dynamics.rewards[order].T),
        transitions,
        observations,
        np.repeat(np.arange(count, dtype=np.int32), width),
        np.arange(count + 1, dtype=np.int64) * width,
    ), order


def _renumbered(rows: Rows, order: Indices, width: int) -> Rows:
    """Return rows with those of each action in another order."""
    size = len(order)
    begins = np.arange(0, len(rows.starts) - 1, size)
    moved = rows.matrix(width)[(begins[:, None] + order).ravel()]
    return Rows(rows.first, moved.indptr.astype(np.uint64), moved.indices.astype(np.uint32), moved.data)
