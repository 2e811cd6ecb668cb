"""A belief filter for factored models too large to flatten: it computes rows of T from the network when needed.

It expands the support of the belief variable by variable, as `flattening` does for all states. Cost of a step: some
numpy calls per variable, and O(possible transitions from the support).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs.filter import SparseFilter
from mdm.models.factored.flattening import following, observed_chances

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.matrices import Vector

__all__ = ["NetworkFilter"]


class NetworkFilter(SparseFilter):
    """Holds a belief by its support, and takes transitions from the network.

    Each event counts as that of a single step: to sum over steps without one takes the matrices of all states.

    Args:
        network: The network, with observations.
    """

    def __init__(self, network: TwoSliceNetwork) -> None:
        assert network.observations is not None
        super().__init__(len(network.states))
        self._network = network

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

    def snapshot(self) -> Any:
        """Return the internal form of the belief, which is normalised."""
        return super().snapshot()[:2]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        states, values = snapshot
        super().restore([states, values, 1.0])

    def _following(self, action: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Vector]:
        of, next_states, chances = following(self._network, action, self._states)
        return of, next_states, self._values[of] * chances

    def _write(self, states: npt.NDArray[np.intp], weights: Vector) -> float:
        total = float(weights.sum())
        if not total > 0:
            return 0.0
        kept = weights > 0
        self._keep(states[kept], weights[kept] / total)
        return min(total, 1.0)


def _summed(states: npt.NDArray[np.intp], weights: Vector) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return each state once, with the sum of its weights."""
    reached, place = np.unique(states, return_inverse=True)
    sums: Any = np.bincount(place, weights, minlength=len(reached))
    return reached, sums
