"""Policies over beliefs as masked alpha vectors, each defined on a subset of the states.

A vector is applicable to a belief if its subset contains the support; the maximal applicable vector decides (T. Smith
and R. Simmons, *Focused real-time dynamic programming for MDPs: squeezing more out of a heuristic*, AAAI 2006, on the
solver ZMDP). A choice costs two products of sparse matrices with a vector.
"""

from __future__ import annotations

from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import csr
from mdm.policies.batch import BeliefBatch
from mdm.policies.policy import BeliefPolicy, Scores, listed, whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.policies.batch import Batch
    from mdm.policies.policy import Arrays, Packed

__all__ = ["MaskedAlphaVectors"]

_SUPPORT = 1e-10
"""Smaller probabilities are rounding errors, not part of the support."""


class MaskedAlphaVectors(BeliefPolicy):
    """Chooses the action of the maximal vector among those defined on all of a belief's support.

    Args:
        vectors: N vectors, each as a mapping from states to values.
        actions: The N vectors' actions.
        num_states: S; by default one more than the largest state.
        num_actions: The number of actions; by default one more than the largest.

    Raises:
        ModelError: If sizes do not fit, a state or action does not exist, or a number is not finite.

    Example::

        policy = mdm.policies.MaskedAlphaVectors([{0: 5.0}, {0: 0.0, 1: 0.0}], actions=[1, 0])
        policy.action([1.0, 0.0]), policy.action([0.9, 0.1])  # 1, 0
    """

    kind: ClassVar[str] = "masked"
    form = "alpha vectors with masks"

    def __init__(
        self,
        vectors: Sequence[Mapping[int, float]],
        actions: Sequence[int],
        num_states: int | None = None,
        num_actions: int | None = None,
    ) -> None:
        if not len(vectors) or not all(vectors):
            raise ModelError("masked alpha vectors need at least one vector, and each at least one state")
        if len(actions) != len(vectors):
            raise ModelError(f"there are {len(vectors)} alpha vectors, but {len(actions)} actions for them")
        self.num_states = max(map(max, vectors)) + 1 if num_states is None else num_states
        self.num_actions = max(actions) + 1 if num_actions is None else num_actions
        for index, (vector, action) in enumerate(zip(vectors, actions, strict=True)):
            if not 0 <= action < self.num_actions:
                raise ModelError(
                    f"alpha vector {index} is for action {action}, but the actions are 0 to {self.num_actions - 1}"
                )
            if not (min(vector) >= 0 and max(vector) < self.num_states):
                raise ModelError(f"alpha vector {index} has a state outside 0 to {self.num_states - 1}")
            if not np.isfinite(list(vector.values())).all():
                raise ModelError(f"alpha vector {index} has a number that is not finite")
        # Sorted by action, so that the first maximum has the lowest action.
        order = sorted(range(len(actions)), key=actions.__getitem__)
        self.vectors: tuple[dict[int, float], ...] = tuple(dict(sorted(vectors[index].items())) for index in order)
        self.actions: list[int] = [int(actions[index]) for index in order]
        # The vectors and their masks (1 for defined) as sparse N x S matrices.
        data = np.array([value for vector in self.vectors for value in vector.values()], dtype=np.float64)
        states = np.array([state for vector in self.vectors for state in vector])
        starts, shape = np.cumsum([0, *map(len, self.vectors)]), (len(self.vectors), self.num_states)
        self._values: Any = csr((data, states, starts), shape)
        self._states: Any = csr((np.ones(len(data)), states, starts), shape)

    def action(self, belief: npt.NDArray[np.float64]) -> int:
        """Return the action for a belief.

        Raises:
            ModelError: If the belief is not over the policy's states, or no vector is defined on all of its support.
        """
        values = self._at(belief)
        best = int(values.argmax())
        if values[best] == -np.inf:
            raise ModelError("no alpha vector of the policy is defined on all of the belief's support")
        return self.actions[best]

    def value(self, belief: npt.NDArray[np.float64]) -> float:
        """Return the expected discounted return from a belief; -inf if no vector is applicable."""
        return float(self._at(belief).max())

    def q_values(self, belief: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the value of each action at a belief; -inf for an action without applicable vectors."""
        values = np.full(self.num_actions, -np.inf)
        np.maximum.at(values, self.actions, self._at(belief))
        return values

    def scores(self, belief: npt.NDArray[np.float64], /) -> Scores:
        """Return the values of its actions at a belief."""
        return Scores("value", self.q_values(belief))

    def facts(self) -> dict[str, int | None]:
        """Return its sizes by name."""
        return {**super().facts(), "vectors": len(self.vectors)}

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        return None if model.pomdp is None else BeliefBatch(self, model.pomdp)

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "starts": np.cumsum([0, *map(len, self.vectors)], dtype=np.int64),
            "states": whole(chain.from_iterable(self.vectors)),
            "values": np.array([value for vector in self.vectors for value in vector.values()], dtype=np.float64),
            "actions": whole(self.actions),
        }
        return {"actions": self.num_actions, "states": self.num_states}, arrays

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        states, values = listed(arrays["states"]), arrays["values"].ravel().tolist()
        parts = pairwise(listed(arrays["starts"]))
        vectors = [dict(zip(states[a:b], values[a:b], strict=True)) for a, b in parts]
        return cls(vectors, listed(arrays["actions"]), sizes["states"], sizes["actions"])

    def _at(self, belief: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the vectors' values at a belief; -inf for inapplicable ones."""
        if np.shape(belief) != (self.num_states,):
            raise ModelError(f"the policy is for beliefs of {self.num_states} numbers, not of shape {np.shape(belief)}")
        support = np.asarray(belief) > _SUPPORT
        values: npt.NDArray[np.float64] = self._values.dot(belief)
        values[self._states.dot(support) < support.sum()] = -np.inf
        return values
