"""Policies over beliefs as alpha vectors: the value function is the maximum of linear functions of the belief.

V(b) = max over vectors of alpha . b, and the action is that of the maximal vector (R. D. Smallwood and E. J. Sondik,
*The optimal control of partially observable Markov processes over a finite horizon*, Operations Research 21, 1973).
A choice costs one product of the N x S matrix with the belief; of a large matrix only of the columns of the support.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, NoReturn, Self

import numpy as np

from mdm.beliefs import Support
from mdm.beliefs.batch import product
from mdm.compilation import can_compile, is_sparing
from mdm.errors import ModelError
from mdm.models.matrices import numbers
from mdm.policies.batch import BeliefBatch
from mdm.policies.policy import BeliefPolicy, Scores, listed, whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.policies.batch import Batch
    from mdm.policies.policy import Arrays, Packed

__all__ = ["AlphaVectors"]

_LARGE = 20_000
"""The number of entries from which it pays to look for the support."""


class AlphaVectors(BeliefPolicy):
    """Chooses the action of the maximal vector at a belief; of equal ones, the lowest action.

    A belief is an array of S numbers, or its `Support`, at a cost that does not grow with S.

    Args:
        vectors: N x S.
        actions: The N vectors' actions.
        num_actions: The number of actions; by default one more than the largest.

    Raises:
        ModelError: If shapes do not fit or a number is not finite.

    Example::

        policy = mdm.policies.AlphaVectors([[1, -1], [0, 0]], actions=[1, 0])
        policy.action([0.9, 0.1])  # 1
        policy.value([0.9, 0.1])  # 0.8
    """

    kind: ClassVar[str] = "alpha"
    form = "alpha vectors"
    by_support = True
    named: tuple[str, ...] = ()
    """The actions as a file names them that was read without the model, which alone knows their indices."""

    def mismatch(self, model: MDP) -> str | None:
        """Return why the policy does not fit a model, as a sentence; None if it fits."""
        if self.named:
            return f"its file names actions ({', '.join(self.named)}): load it with the model, load_policy(path, model)"
        return super().mismatch(model)

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
            if not hasattr(action, "__index__") or action < 0:
                raise ModelError(f"alpha vector {vector} is for action {action}; actions are whole numbers from 0 on")
        self.num_actions = int(max(actions)) + 1 if num_actions is None else num_actions
        if max(actions) >= self.num_actions:
            raise ModelError(
                f"alpha vector {int(np.argmax(actions))} is for action {max(actions)}, but the actions are "
                f"0 to {self.num_actions - 1}"
            )
        self.num_states = matrix.shape[1]
        # Sorted by action, so that the first maximum has the lowest action.
        order = np.argsort(np.asarray(actions), kind="stable")
        # A row per state, so that the rows of a support are contiguous.
        self._by_state = np.ascontiguousarray(matrix[order].T)
        self._by_state.setflags(write=False)
        self.vectors = self._by_state.T
        self._is_large = matrix.size >= _LARGE
        self._at_belief, self._at_support = _at_belief, _at_support
        if self._is_large and not is_sparing() and can_compile():
            from mdm.policies.alpha_kernels import at_belief, at_support  # noqa: PLC0415 - numba is slow to import

            self._at_belief, self._at_support = at_belief, at_support
            one = Support(np.zeros(1, np.intp), np.ones(1))
            for belief in (one, one.dense(self.num_states), np.zeros(self.num_states)):
                self._at(belief)  # compiled now, not at the first choice; also for writeable arrays
        self.actions: list[int] = [int(actions[index]) for index in order]

    def action(self, belief: npt.NDArray[np.float64] | Support) -> int:
        """Return the action for a belief.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        # Hot path: array methods cost half of numpy's functions.
        if self._is_large or belief.__class__ is Support:
            return self.actions[self._at(belief).argmax()]
        try:
            best: int = self.vectors.dot(belief).argmax()
        except ValueError:
            self._refuse(belief)
        return self.actions[best]

    def value(self, belief: npt.NDArray[np.float64] | Support) -> float:
        """Return the expected discounted return from a belief.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        return float(self._at(belief).max())

    def q_values(self, belief: npt.NDArray[np.float64] | Support) -> npt.NDArray[np.float64]:
        """Return the value of each action at a belief; -inf for an action without vectors.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        values = np.full(self.num_actions, -np.inf)
        np.maximum.at(values, self.actions, self._at(belief))
        return values

    def scores(self, belief: npt.NDArray[np.float64] | Support, /) -> Scores:
        """Return the values of its actions at a belief."""
        return Scores("value", self.q_values(belief))

    def actions_at(self, beliefs: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
        """Return the action for each belief, N x S."""
        chosen: npt.NDArray[np.intp] = np.asarray(self.actions)[product(beliefs, self.vectors.T).argmax(axis=1)]
        return chosen

    def facts(self) -> dict[str, int | None]:
        """Return its sizes by name."""
        return {**super().facts(), "vectors": len(self.vectors)}

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        return None if model.pomdp is None else BeliefBatch(self, model.pomdp)

    def for_first_states(self, count: int) -> AlphaVectors:
        """Return its vectors for the first so many states."""
        return AlphaVectors(self.vectors[:, :count], self.actions, self.num_actions)

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {"actions": self.num_actions}, {"vectors": self.vectors, "actions": whole(self.actions)}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        return cls(arrays["vectors"], listed(arrays["actions"]), sizes["actions"])

    def _at(self, belief: npt.NDArray[np.float64] | Support) -> npt.NDArray[np.float64]:
        """Return the value of each vector at a belief."""
        values: npt.NDArray[np.float64]
        try:
            if isinstance(belief, Support):
                values = self._at_support(self._by_state, *belief)
            elif self._is_large:
                belief = np.ascontiguousarray(belief, np.float64)
                if belief.shape != (self.num_states,):
                    self._refuse(belief)
                values = self._at_belief(self._by_state, belief)
            else:
                values = self.vectors.dot(belief)
        except (ValueError, IndexError):
            self._refuse(belief)
        return values

    def _refuse(self, belief: npt.NDArray[np.float64] | Support) -> NoReturn:
        if isinstance(belief, Support):
            raise ModelError(
                f"the policy is for beliefs over {self.num_states} states: a state of the belief is none of them"
            ) from None
        shape = np.shape(belief)
        raise ModelError(f"the policy is for beliefs of {self.num_states} numbers, not of shape {shape}") from None


def _at_belief(by_state: npt.NDArray[np.float64], belief: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the values of N vectors, given as S x N, at a belief."""
    (states,) = belief.nonzero()
    if len(states) * 4 < len(belief):  # for a larger support, copying the rows costs more than it saves
        return _at_support(by_state, states, belief[states])
    values: npt.NDArray[np.float64] = belief.dot(by_state)
    return values


def _at_support(
    by_state: npt.NDArray[np.float64], states: npt.NDArray[np.intp], weights: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the values of N vectors at a belief, given by its support."""
    if states.min(initial=0) < 0:  # a negative index
        raise IndexError
    values: npt.NDArray[np.float64] = weights.dot(by_state.take(states, 0))
    return values
