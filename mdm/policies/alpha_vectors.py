"""Policies over beliefs as alpha vectors: the value function is the maximum of linear functions of the belief.

V(b) = max over vectors of alpha . b, and the action is that of the maximal vector (R. D. Smallwood and E. J. Sondik,
*The optimal control of partially observable Markov processes over a finite horizon*, Operations Research 21, 1973).
A choice costs one product of the N x S matrix with the belief.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NoReturn, SupportsIndex

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import numbers

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

__all__ = ["AlphaVectors"]


class AlphaVectors:
    """Chooses the action of the vector that is maximal at a belief; of equal ones, the lowest action.

    Args:
        vectors: N x S.
        actions: The N vectors' actions.
        num_actions: How many actions there are; by default one more than the largest.

    Raises:
        ModelError: If shapes do not fit or a number is not finite.
    """

    input: Literal["belief"] = "belief"

    def __init__(self, vectors: npt.ArrayLike, actions: Sequence[int], num_actions: int | None = None) -> None:
        matrix = numbers(vectors, "the array of alpha vectors")
        if matrix.ndim != 2 or 0 in matrix.shape:
            raise ModelError(f"alpha vectors are a vectors x states array, not one of shape {matrix.shape}")
        if len(actions) != len(matrix):
            raise ModelError(f"there are {len(matrix)} alpha vectors, but {len(actions)} actions for them")
        if not np.isfinite(matrix).all():
            vector = int((~np.isfinite(matrix)).any(axis=1).argmax())
            raise ModelError(f"alpha vector {vector} has a number that is not finite")
        for vector, action in enumerate(actions):
            if not isinstance(action, SupportsIndex) or action < 0:
                raise ModelError(f"alpha vector {vector} is for action {action}; actions are whole numbers from 0 on")
        self.num_actions = max(actions) + 1 if num_actions is None else num_actions
        if max(actions) >= self.num_actions:
            raise ModelError(
                f"alpha vector {int(np.argmax(actions))} is for action {max(actions)}, but the actions are "
                f"0 to {self.num_actions - 1}"
            )
        self.num_states = matrix.shape[1]
        # In the order of their actions, so that the first maximum is that of the lowest action.
        order = np.argsort(np.asarray(actions), kind="stable")
        self.vectors = np.ascontiguousarray(matrix[order])
        self.vectors.setflags(write=False)
        self.actions: list[int] = [int(actions[index]) for index in order]

    def action(self, belief: npt.NDArray[np.float64]) -> int:
        """Return the action for a belief.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        # Hot path: methods of arrays, at half the cost of numpy's functions.
        try:
            best: int = self.vectors.dot(belief).argmax()
        except ValueError:
            self._refuse(belief)
        return self.actions[best]

    def value(self, belief: npt.NDArray[np.float64]) -> float:
        """Return the expected discounted return from a belief.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        return float(self.q_values(belief).max())

    def q_values(self, belief: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the value of each action at a belief; -inf for an action without vectors, which is never chosen."""
        values = np.full(self.num_actions, -np.inf)
        try:
            np.maximum.at(values, self.actions, self.vectors.dot(belief))
        except ValueError:
            self._refuse(belief)
        return values

    def _refuse(self, belief: npt.NDArray[np.float64]) -> NoReturn:
        shape = np.shape(belief)
        raise ModelError(f"the policy is for beliefs of {self.num_states} numbers, not of shape {shape}") from None
