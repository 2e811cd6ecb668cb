"""Belief filters for large models: products of transposed CSR matrices with a belief over all states.

Cost of a step: O(non-zeros of T); with numba, of the rows of next states in which the observation is possible.
"""

from __future__ import annotations

import operator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs.filter import WholeFilter
from mdm.models.dynamics import once

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.beliefs.filter import Support
    from mdm.models.dynamics import Dynamics
    from mdm.models.matrices import Matrix, Vector

_FOLDED = 4_000_000


class WideFilter(WholeFilter):
    """The base of filters by compressed matrices.

    Attributes:
        size: The size of the support of the belief.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__(dynamics.num_states)
        self._dynamics = dynamics
        self._false_negative = dynamics.model.false_negative
        self._resolvents = dynamics.resolvents
        self._waits = any(resolvent is not None for resolvent in self._resolvents)
        self.size = 0

    def load(self, belief: Support) -> None:
        """Load a belief."""
        super().load(belief)
        self.size = len(belief.states)

    def snapshot(self) -> Any:
        """Return the internal form of the belief."""
        return [*super().snapshot(), self.size]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        *held, size = snapshot
        super().restore(held)
        self.size = operator.index(size)

    def _reached(self, action: int, observation: int) -> Vector:
        """Return the belief times the resolvent of the steps without a detection before an observation."""
        resolvent = self._resolvents[action]
        if resolvent is None or observation == self._false_negative:
            return self._before
        reached: Vector = resolvent.weights(self._before)
        return reached

    def _accept(self, total: float, size: int) -> float:
        """Accept the next belief, given its sum and support size; return the quotient of the two sums."""
        if total > 0:
            self.size = size
        return self._take(total)


class CompressedFilter(WideFilter):
    """The filter by scipy: a matrix per action and observation if these fit, else T and then P(o | a, s').

    Args:
        dynamics: The model.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        super().__init__(dynamics)
        self._transposed = once(dynamics.transition_matrices, lambda matrix: matrix.T.tocsr())
        self._joints: list[list[Matrix]] | None = None
        if dynamics.moves_by_joints:
            self._joints = [[joint.T.tocsr() for joint in joints] for joints in dynamics.joint_matrices]
            return
        self._columns = once(dynamics.observation_matrices, lambda matrix: matrix.tocsc())
        if held_numbers(dynamics) * dynamics.num_observations <= _FOLDED:
            self._joints = [
                [self._fold(action, observation) for observation in range(dynamics.num_observations)]
                for action in range(len(dynamics.transition_matrices))
            ]

    def _fold(self, action: int, observation: int) -> Matrix:
        """Return T transposed, times P(o | a, s')."""
        likelihood = self._likelihood(action, [observation])
        matrix = self._transposed[action].copy()
        matrix.data *= np.repeat(likelihood, np.diff(matrix.indptr))
        matrix.eliminate_zeros()
        return matrix

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        if self._joints is None:
            after = self._transposed[action] @ self._before
            after *= self._likelihood(action, observations)
        else:
            before, joints = self._reached(action, observations[0]), self._joints[action]
            after = joints[observations[0]] @ before
            for observation in observations[1:]:
                after += joints[observation] @ before
        return self._write(after)

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        return self._write(self._transposed[action] @ self._before)

    def _write(self, after: Vector) -> float:
        self._after = after
        # Not a product with ones: waking the threads of BLAS can take longer than all the rest.
        return self._accept(float(after.sum()), int(np.count_nonzero(after)))

    def _likelihood(self, action: int, observations: Sequence[int]) -> Vector:
        """Return P(one of some observations | action, s') for each s'."""
        matrix = self._columns[action]
        likelihood = np.zeros(self._dynamics.num_states)
        for observation in observations:
            filled = slice(matrix.indptr[observation], matrix.indptr[observation + 1])
            likelihood[matrix.indices[filled]] += matrix.data[filled]
        return likelihood


class GroupedFilter(WideFilter):
    """The filter by numba: rows of the transposed matrices are grouped by length, see `kernels.pull`.

    Args:
        dynamics: The model.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        from mdm.beliefs.kernels import pull  # noqa: PLC0415 - numba is slow to import

        super().__init__(dynamics)
        self._pull: Any = pull
        everything = np.arange(dynamics.num_states, dtype=np.uint32), np.ones(dynamics.num_states)
        layouts = self._layouts = once(dynamics.transition_matrices, _Layout)
        self._predictions: list[Any] = [layout.all_rows(*everything) for layout in layouts]
        self._moves: list[list[Any]]
        if dynamics.moves_by_joints:
            joints = dynamics.joint_matrices
            self._moves = [[_Layout(joint).all_rows(*everything) for joint in each] for each in joints]
        else:
            told = dynamics.observation_matrices
            self._moves = [layout.columns(matrix) for layout, matrix in zip(layouts, told, strict=True)]
        self.predict(0)  # compiled now, not at the first step

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        before = self._reached(action, observation) if self._waits else self._before
        return self._accept(*self._pull(*self._moves[action][observation], before, self._after))

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        moves = self._moves[action]
        if not self._dynamics.moves_by_joints:
            layout = self._layouts[action]
            likelihood = np.zeros(self._dynamics.num_states)
            for observation in observations:
                *_, places, chances = moves[observation]
                likelihood[places] += chances
            (places,) = likelihood.nonzero()
            move = layout.some_rows(places.astype(np.uint32), likelihood[places])
            return self._accept(*self._pull(*move, self._before, self._after))
        before = self._reached(action, observations[0])
        after = np.zeros(self._dynamics.num_states)
        for observation in observations:
            self._pull(*moves[observation], before, self._after)
            after += self._after
        self._after = after
        return self._accept(float(after.sum()), int(np.count_nonzero(after)))

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        return self._accept(*self._pull(*self._predictions[action], self._before, self._after))


class _Layout:
    """A transposed CSR matrix with rows grouped by length, as the arguments of `kernels.pull`."""

    def __init__(self, matrix: Matrix) -> None:
        from mdm.beliefs.kernels import arrange  # noqa: PLC0415 - numba is slow to import

        size = matrix.shape[0]
        lengths = np.bincount(matrix.indices, minlength=size)
        targets = np.argsort(lengths, kind="stable")
        ordered = lengths[targets]
        self._place = np.empty(size, np.uint32)
        self._place[targets] = np.arange(size, dtype=np.uint32)
        each, first = np.unique(ordered, return_index=True)
        starts = np.concatenate(([0], np.cumsum(ordered))).astype(np.uint64)
        self._first = np.append(first, size).astype(np.uint64)
        sources, weights = np.empty(matrix.nnz, np.uint32), np.empty(matrix.nnz)
        arrange(*unsigned(matrix), starts[self._place], sources, weights)
        self._arrays = (
            self._first,
            each.astype(np.uint64),
            starts[first],
            targets.astype(np.uint32),
            sources,
            weights,
        )

    def all_rows(self, places: npt.NDArray[np.uint32], likelihood: Vector) -> Any:
        """Return the arguments for all next states, with their likelihood."""
        return (*self._arrays, self._first, places, likelihood)

    def some_rows(self, places: npt.NDArray[np.uint32], likelihood: Vector) -> Any:
        """Return the arguments for some next states, given by place, with their likelihood."""
        return (*self._arrays, np.searchsorted(places, self._first).astype(np.uint64), places, likelihood)

    def columns(self, observations: Matrix) -> list[Any]:
        """Return the arguments for each observation, from P(o | s'), S' x O."""
        states = np.repeat(np.arange(observations.shape[0]), np.diff(observations.indptr))
        places = self._place[states]
        order = np.lexsort((places, observations.indices))
        places, likelihood = places[order], observations.data[order]
        cuts = np.searchsorted(observations.indices[order], np.arange(observations.shape[1] + 1))
        return [self.some_rows(places[start:end], likelihood[start:end]) for start, end in pairwise(cuts)]


def held_numbers(dynamics: Dynamics) -> int:
    """Return the total size of the matrices of belief updates: entries and row starts."""
    moved = dynamics.transition_matrices
    if dynamics.moves_by_joints:
        moved = [matrix for matrices in dynamics.joint_matrices for matrix in matrices]
    return sum(matrix.nnz + matrix.shape[0] for matrix in {id(matrix): matrix for matrix in moved}.values())


def unsigned(matrix: Matrix) -> tuple[Any, Any, Vector]:
    """Return the row starts, columns and entries of a CSR matrix, as the kernels take them."""
    columns = matrix.indices.view(np.uint32) if matrix.indices.dtype == np.int32 else matrix.indices.astype(np.uint32)
    data = matrix.data.view()
    columns.flags.writeable = data.flags.writeable = False  # as in models: numba compiles for one kind
    return matrix.indptr.astype(np.uint64), columns, data
