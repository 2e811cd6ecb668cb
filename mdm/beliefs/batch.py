"""The beliefs of a batch of episodes, as a matrix with a row per episode.

Episodes with the same action and observation share one product with P(s', o | s, a). An update costs O(S^2) or
O(non-zeros of T) per episode, and loops over pairs of action and observation only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models.matrices import is_compressed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.models import POMDP
    from mdm.models.matrices import Matrix, Vector

Indices = Any

_ONE_THREAD = 1 << 18
"""The number of multiplications up to which OpenBLAS uses a single thread."""


class BatchTracker:
    """Tracks the beliefs of a batch of episodes, as `BeliefTracker` does for one.

    Args:
        model: The model.
    """

    def __init__(self, model: POMDP) -> None:
        self._model = model
        self._num_observations = len(model.observation_space)
        self._joints: dict[tuple[int, int], Matrix] = {}
        self.beliefs: Vector = np.empty((0, len(model.state_space)))
        """A row per episode."""

    def begin(self, states: Indices) -> None:
        """Begin with an agent's beliefs at the start of episodes in some states."""
        first, inverse = np.unique(states, return_inverse=True)
        self.beliefs = np.stack([self._model.belief_at_start(int(state)) for state in first])[inverse]

    def update(self, episodes: Indices, actions: Indices, observations: Indices) -> None:
        """Update the beliefs of some episodes."""
        for where, key in grouped(actions * self._num_observations + observations):
            rows = episodes[where]
            action, observation = divmod(key, self._num_observations)
            before = self.beliefs[rows]
            after = self._moved(before, action, observation)
            totals = after.sum(axis=1)
            lost = ~(totals > 0)
            if lost.any():  # impossible by rounding: predict, as a controller does
                after[lost] = before[lost] @ self._model.transition_matrix(action)
                totals[lost] = after[lost].sum(axis=1)
            after /= totals[:, None]
            self.beliefs[rows] = after

    def keep(self, which: Indices) -> None:
        """Keep some episodes, and drop the others."""
        self.beliefs = self.beliefs[which]

    def _moved(self, beliefs: Vector, action: int, observation: int) -> Vector:
        model, joint = self._model, self._joints.get((action, observation))
        misses = observation != model.false_negative and model.waits_in(action)
        if joint is None:
            joint = model.joint_matrix(action, observation)
            if misses and not is_compressed(joint):
                joint = model.resolvent(action).values(joint)
            self._joints[action, observation] = joint
        if misses and is_compressed(joint):
            beliefs = model.resolvent(action).weights(beliefs)
        return product(beliefs, joint)


def product(rows: Vector, matrix: Matrix) -> Vector:
    """Return rows times a matrix.

    A dense product is split into parts that BLAS computes in one thread. On a busy machine its threads wait for each
    other far longer than a product takes (measured: 36,000 instead of 200,000 steps a second).
    """
    part = max(1, _ONE_THREAD // (matrix.shape[0] * matrix.shape[1]))
    if len(rows) <= part or is_compressed(matrix):
        return np.asarray(rows @ matrix)
    result = np.empty((len(rows), matrix.shape[1]))
    for first in range(0, len(rows), part):
        np.matmul(rows[first : first + part], matrix, out=result[first : first + part])
    return result


def grouped(keys: Indices) -> Iterator[tuple[Indices, int]]:
    """Yield the positions of each key, and the key, in ascending order."""
    order = np.argsort(keys.astype(np.uint16) if keys.max(initial=0) < 1 << 16 else keys, kind="stable")
    edges = np.flatnonzero(np.diff(keys[order])) + 1
    for where in np.split(order, edges):
        if len(where):
            yield where, int(keys[where[0]])
