"""Belief filters by support: the states of non-zero probability.

Cost of a step: O(non-zeros of their rows of T), however many states the model has. For factored models too large to
flatten the rows of T are computed from the network when needed: the support is expanded variable by variable, as
`flattening` does for all states, at some numpy calls per variable and O(possible transitions from the support).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs.compressed import unsigned
from mdm.beliefs.filter import SparseFilter
from mdm.models.dynamics import once
from mdm.models.factored.flattening import following, observed_chances

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.dynamics import Dynamics
    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.matrices import Matrix, Vector


class SupportFilter(SparseFilter):
    """The filter by numpy: gathers the rows of the support.

    Args:
        dynamics: The model, without false negatives: these spread over all states.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__(dynamics.num_states)
        self._dynamics = dynamics

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        if self._dynamics.moves_by_joints:
            joints = self._dynamics.joint_matrices[action]
            parts = [_entries(joints[o], self._states[: self.size]) for o in observations]
            return self._write(*self._summed(parts))
        states, values = self._summed([_entries(self._dynamics.transition_matrices[action], self._states[: self.size])])
        wanted = np.zeros(self._dynamics.num_observations, np.bool_)
        wanted[list(observations)] = True
        of, symbols, chances = _entries(self._dynamics.observation_matrices[action], states)
        chosen = wanted[symbols]
        values *= np.bincount(of[chosen], chances[chosen], minlength=len(states))
        return self._write(states, values)

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        return self._write(
            *self._summed([_entries(self._dynamics.transition_matrices[action], self._states[: self.size])])
        )

    def _summed(self, parts: list[tuple[npt.NDArray[np.intp], Any, Vector]]) -> tuple[npt.NDArray[Any], Vector]:
        """Return the next states, and the weight of each."""
        reached = np.concatenate([targets for _, targets, _ in parts])
        weights = np.concatenate([self._values[of] * data for of, _, data in parts])
        return _each_once(reached, weights)

    def _write(self, states: npt.NDArray[Any], values: Vector) -> float:
        kept = values > 0
        total = float(values.sum())
        if not total > 0:
            return 0.0
        self._keep(states[kept], values[kept])
        return self._take(total)


class CompiledSupportFilter(SupportFilter):
    """The same by numba, see `kernels.push`: a step takes a microsecond or two for twenty states.

    Args:
        dynamics: The model, without false negatives.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        from mdm.beliefs.kernels import push  # noqa: PLC0415 - numba is slow to import

        super().__init__(dynamics)
        self._push: Any = push
        size = dynamics.num_states
        # The operating system allocates only the pages that are written to.
        self._states, self._next_states = np.empty(size, np.uint32), np.empty(size, np.uint32)
        self._values, self._next_values = np.empty(size), np.empty(size)
        self._sums = np.zeros(size)
        self._matrices = once(dynamics.transition_matrices, unsigned)
        nothing = np.zeros(1, np.uint64), np.zeros(0, np.uint32), np.zeros(0)
        for array in nothing[1:]:
            array.flags.writeable = False
        self._predictions: list[tuple[Any, ...]] = [(*matrix, *nothing, -1) for matrix in self._matrices]
        self._moves: list[list[tuple[Any, ...]]]
        if dynamics.moves_by_joints:
            self._moves = [[(*unsigned(joint), *nothing, -1) for joint in each] for each in dynamics.joint_matrices]
        else:
            seen = once(dynamics.observation_matrices, unsigned)
            symbols = range(dynamics.num_observations)
            self._moves = [
                [(*matrix, *chances, symbol) for symbol in symbols]
                for matrix, chances in zip(self._matrices, seen, strict=True)
            ]
        self._run(self._moves[0][0])  # compiled now, not at the first step

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        return self._run(self._moves[action][observation])

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        return self._run(self._predictions[action])

    def _run(self, move: tuple[Any, ...]) -> float:
        total, size = self._push(
            *move, self._states, self._values, self.size, self._sums, self._next_states, self._next_values
        )
        if not total > 0:
            return 0.0
        self._swap(size)
        return self._take(total)

    def _keep(self, states: npt.NDArray[Any], values: Vector) -> None:
        size = len(states)
        self._next_states[:size] = states
        self._next_values[:size] = values
        self._swap(size)

    def _swap(self, size: int) -> None:
        self._states, self._next_states = self._next_states, self._states
        self._values, self._next_values = self._next_values, self._values
        self.size = size


def _entries(matrix: Matrix, rows: npt.NDArray[Any]) -> tuple[npt.NDArray[np.intp], npt.NDArray[Any], Vector]:
    """Return the entries of some rows of a CSR matrix: place of the row, column, value."""
    starts = matrix.indptr[rows]
    lengths = matrix.indptr[rows + 1] - starts
    of = np.repeat(np.arange(len(rows)), lengths)
    at = np.arange(len(of)) + np.repeat(starts - (np.cumsum(lengths) - lengths), lengths)
    return of, matrix.indices[at], matrix.data[at]


# -- Networks ----------------------------------------------------------------------------------------------------------


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
            next_states, weights = _each_once(next_states, weights)
        chances = observed_chances(self._network, action, before, next_states, observations)
        if before is not None:
            next_states, weights = _each_once(next_states, weights * chances)
        else:
            weights = weights * chances
        return self._write(next_states, weights)

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        _, next_states, weights = self._following(action)
        return self._write(*_each_once(next_states, weights))

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


def _each_once(states: npt.NDArray[np.intp], weights: Vector) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return each state once, with the sum of its weights."""
    reached, place = np.unique(states, return_inverse=True)
    sums: Any = np.bincount(place, weights, minlength=len(reached))
    return reached, sums
