"""The dynamics of SARSOP, with the states in blocks that observations tell apart.

Where part of the state is seen (mixed observability), beliefs never leave the states of one value of it. Such states
make a block; states are renumbered so that a block's lie side by side, and vectors are over one block each.

Where observations are events, and where there are false negatives, an action leads to *arrivals*: pairs of a state and
what is observed on the way there. Its transition is the one to the next detection: the discounted steps without one,
and the step that ends in it (see `mdm.solvers.joint_dynamics`). Else a state is its own arrival.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.models.dynamics import Dynamics, Indices, Rows, dense, stacked
from mdm.models.matrices import csr

if TYPE_CHECKING:
    from mdm.models import POMDP
    from mdm.models.matrices import Matrix
    from mdm.solvers.joint_dynamics import JointDynamics

__all__ = ["Layout", "bytes_of_arrivals", "layout_of"]

Integers = npt.NDArray[np.int32]
Long = npt.NDArray[np.int64]

_BYTES = 32
"""For each number of T: itself and its column, in one matrix and in all of them together."""


class Layout(NamedTuple):
    """A model's numbers.

    Attributes:
        discount: In (0, 1).
        rewards: A x S.
        transitions: T, from states to arrivals.
        observations: O, a row for each arrival.
        state: Each arrival's state.
        block: Each state's block.
        first_state: Where each block begins, and the end of the last.
    """

    discount: float
    rewards: npt.NDArray[np.float64]
    transitions: Rows
    observations: Rows
    state: Long
    block: Integers
    first_state: Long


def layout_of(model: POMDP, dynamics: Dynamics, detections: JointDynamics | None = None) -> tuple[Layout, Indices]:
    """Return a model's layout, and the model's states in the layout's order.

    Args:
        model: The model.
        dynamics: Its dynamics.
        detections: What leads to detections, where observations are events or may be missed.
    """
    blocks = model.layout
    order: Indices = blocks.ravel()
    rewards = dynamics.rewards.T
    if detections is not None:
        rewards = np.stack([detections.earned(action, values) for action, values in enumerate(detections.rewards)])
        transitions, observations, state = _arrivals(detections, order)
    else:
        transitions, observations, state = dynamics.transitions, dynamics.observations, np.arange(len(order))
        if len(blocks) > 1:
            transitions = _renumbered(transitions, order, len(order))
            transitions = transitions._replace(columns=_places(order)[transitions.columns].astype(np.uint32))
            observations = _renumbered(observations, order, dynamics.num_observations)
    count, width = blocks.shape
    return Layout(
        dynamics.discount,
        np.ascontiguousarray(rewards[:, order]),
        transitions,
        observations,
        state,
        np.repeat(np.arange(count, dtype=np.int32), width),
        np.arange(count + 1, dtype=np.int64) * width,
    ), order


def _places(order: Indices) -> Indices:
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    return place


def _renumbered(rows: Rows, order: Indices, width: int) -> Rows:
    """Return rows with those of each action in another order."""
    size = len(order)
    begins = np.arange(0, len(rows.starts) - 1, size)
    moved = rows.matrix(width)[(begins[:, None] + order).ravel()]
    return Rows(rows.first, moved.indptr.astype(np.uint64), moved.indices.astype(np.uint32), moved.data)


def bytes_of_arrivals(detections: JointDynamics) -> int:
    """Return about how many bytes the rows take of actions that go on without a detection; they have few zeros."""
    widths = [len(detections.columns(a)[0]) for a in range(detections.num_actions) if detections.waits_in(a)]
    return _BYTES * detections.size * sum(widths)


def _arrivals(detections: JointDynamics, order: Indices) -> tuple[Rows, Rows, Long]:
    """Return T to arrivals, what is observed at them, and their states; arrivals are ordered by observation."""
    size, place = len(order), _places(order)
    columns = [o * size + place[s] for o, s in map(detections.columns, range(detections.num_actions))]
    arrivals = np.unique(np.concatenate([[0], *columns]))  # one at least, where nothing is ever detected
    matrices: list[Matrix] = []
    for action, own in enumerate(columns):
        matrix = detections.ahead[action]
        if detections.waits_in(action):
            matrix = detections.earned(action, dense(matrix))
        rows = csr(matrix[order])
        parts = rows.data, np.searchsorted(arrivals, own)[rows.indices], rows.indptr
        matrices.append(csr(parts, (size, len(arrivals))))
    symbols, state = np.divmod(arrivals, size)
    count = len(arrivals)
    first, starts = np.zeros(len(columns), dtype=np.int64), np.arange(count + 1, dtype=np.uint64)
    return stacked(matrices), Rows(first, starts, symbols.astype(np.uint32), np.ones(count)), state
