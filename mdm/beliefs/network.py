"""A belief filter for factored models too large to flatten: it computes rows of T from the network when needed.

It expands the support of the belief variable by variable, as `flattening` does for all states. Cost of a step: some
numpy calls per variable, and O(possible transitions from the support).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs.filter import Support
from mdm.models.factored.flattening import following, observed_chances

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.matrices import Vector

__all__ = ["NetworkFilter"]


class NetworkFilter:
    """Holds a belief by its support, and takes transitions from the network.

    Each event counts as that of a single step: to sum over steps without one takes the matrices of all states.

    Args:
        network: The network, with observations.
    """

    is_sparse = True

    def __init__(self, network: TwoSliceNetwork) -> None:
        assert network.observations is not None
        self._network = network
        self._size = len(network.states)
        self._states: npt.NDArray[np.intp] = np.empty(0, np.intp)
        self._values: Vector = np.empty(0)

    def load(self, belief: Support) -> None:
        """Load a belief."""
        self._states, self._values = belief.states, belief.probabilities

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        return self.step_any(action, (observation,))

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        of, next_states, weights = self._following(action)
        before = self._states[of] if self._network.event_observations else None
        if before is None:
            next_states, weights = _summed(next_states, weights)
        chances = observed_chances(self._network, action, before, next_states, observations)
        if before is not None:
            next_states, weights = _summed(next_states, weights * chances)
        else:
            weights = weights * chances
        return self._write(next_states, weights)

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        _, next_states, weights = self._following(action)
        return self._write(*_summed(next_states, weights))

    def dense(self) -> Vector:
        """Return the belief as a new array of S numbers, read-only."""
        return self.support().dense(self._size)

    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""
        return Support(self._states.copy(), self._values.copy())

    def snapshot(self) -> Any:
        """Return the internal form of the belief."""
        return [self._states.astype(np.int64).tobytes(), self._values.tobytes()]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        states, values = snapshot
        self._states = np.frombuffer(states, np.int64).astype(np.intp)
        self._values = np.frombuffer(values).reshape(self._states.shape).copy()

    def _following(self, action: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Vector]:
        of, next_states, chances = following(self._network, action, self._states)
        return of, next_states, self._values[of] * chances

    def _write(self, states: npt.NDArray[np.intp], weights: Vector) -> float:
        total = float(weights.sum())
        if not total > 0:
            return 0.0
        kept = weights > 0
        self._states, self._values = states[kept], weights[kept] / total
        return min(total, 1.0)


def _summed(states: npt.NDArray[np.intp], weights: Vector) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return each state once, with the sum of its weights."""
    reached, place = np.unique(states, return_inverse=True)
    sums: Any = np.bincount(place, weights, minlength=len(reached))
    return reached, sums
