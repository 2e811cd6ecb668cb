"""All actions' transitions as one matrix, so that one sweep over the states is one pass through the memory.

Row s A + a holds P(s' | s, a): what a state's backup reads lies together. The matrix is CSR, or dense where more than
a quarter of it is not zero. A backup computes Q(s, a) = R(s, a) + discount * P(. | s, a) V for all states, which costs
one pass over the matrix.

CSR matrices are swept by compiled kernels where there is numba, each state with the newest values of the others
(Gauss-Seidel); without it, and for dense matrices, all states at once by scipy's and BLAS's products (Jacobi), which
takes more sweeps to the same values.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models.compilation import can_compile
from mdm.models.compressed import csr, is_compressed

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Matrix, Vector

    Actions = npt.NDArray[np.intp]

__all__ = ["Stack", "unsigned"]

_DENSE = 0.25


class Stack:
    """The dynamics and rewards of a model, for solvers.

    Args:
        model: An MDP, or a POMDP whose state is taken to be seen; factored ones are flattened.
    """

    def __init__(self, model: MDP) -> None:
        flat = model.flatten()
        self.discount = flat.discount
        self.rewards: Vector = np.ascontiguousarray(flat.rewards)
        """R(s, a): S x A."""
        self.size, self.num_actions = self.rewards.shape
        self.state_names = flat.state_space.names
        matrices = [flat.transition_matrix(action) for action in range(self.num_actions)]
        self.matrix: Matrix = _stacked(matrices, self.size)
        """P(s' | s, a): row s A + a, column s'."""
        self.kernels: Any = None
        """The compiled sweeps over it; None where there are none."""
        if is_compressed(self.matrix) and can_compile():
            from mdm.solvers.mdp import sweeps  # noqa: PLC0415 - imports numba

            self.kernels = sweeps

    @property
    def entries(self) -> int:
        """How many numbers one sweep goes over."""
        return int(self.matrix.nnz if is_compressed(self.matrix) else self.matrix.size)

    @property
    def parts(self) -> tuple[Any, ...]:
        """What every kernel takes first."""
        return *unsigned(self.matrix), self.rewards, self.discount

    def q_values(self, values: Vector) -> Vector:
        """Return Q(s, a) of what the states are worth: S x A."""
        table: Vector = (self.matrix @ values).reshape(self.size, self.num_actions)
        table *= self.discount
        table += self.rewards
        return table

    def backup(self, values: Vector) -> tuple[Vector, Actions]:
        """Return what the best action makes of each state's value, and that action; of equal ones the lowest."""
        if self.kernels is None:
            table = self.q_values(values)
            policy = table.argmax(axis=1)
            return table[np.arange(self.size), policy], policy
        backed, policy = np.empty(self.size), np.empty(self.size, dtype=np.intp)
        self.kernels.backup(*self.parts, values, backed, policy)
        return backed, policy

    def sweep(self, values: Vector, policy: Actions, most: int, each: int, tolerance: float) -> None:
        """Back states up, in place, until a sweep for the best actions changes none by more than the tolerance.

        Args:
            values: What the states are worth.
            policy: Actions per state; the best when it ends, about.
            most: The most sweeps.
            each: Every so many sweeps look for the best actions, the first among them; those between take what it
                found.
            tolerance: When to stop before.
        """
        if self.kernels is not None:
            self.kernels.sweep(*self.parts, values, policy, most, each, tolerance)
            return
        matrix, rewards = self.matrix, self.rewards
        for turn in range(most):
            if turn % each == 0:
                backed, policy[:] = self.backup(values)
                change = np.abs(backed - values).max()
                if each > 1:
                    matrix, rewards = self.under(policy)
            else:
                backed = rewards + self.discount * (matrix @ values)
            values[:] = backed
            if turn % each == 0 and not change > tolerance:
                return

    def under(self, policy: Actions) -> tuple[Matrix, Vector]:
        """Return the transitions and rewards that a policy leaves: S x S' and S."""
        states = np.arange(self.size)
        return self.matrix[states * self.num_actions + policy], self.rewards[states, policy]


def unsigned(matrix: Matrix) -> tuple[Any, Any, Any]:
    """Return the arrays of a CSR matrix as kernels take them: data, indices and starts of rows."""
    kind = f"u{matrix.indices.dtype.itemsize}"
    return matrix.data, matrix.indices.view(kind), matrix.indptr.view(kind)


def _stacked(matrices: list[Matrix], size: int) -> Matrix:
    """Return matrices as one, whose row s A + a is row s of matrix a."""
    count = len(matrices)
    entries = sum(matrix.nnz if is_compressed(matrix) else int(np.count_nonzero(matrix)) for matrix in matrices)
    if entries > _DENSE * count * size * size:
        dense = [matrix.toarray() if is_compressed(matrix) else matrix for matrix in matrices]
        return np.stack(dense, axis=1).reshape(size * count, size)
    parts = [matrix if is_compressed(matrix) else csr(matrix) for matrix in matrices]
    lengths = np.stack([np.diff(part.indptr) for part in parts], axis=1)
    wide = max(entries, size * count) > np.iinfo(np.int32).max
    starts = np.zeros(size * count + 1, dtype=np.int64 if wide else np.int32)
    np.cumsum(lengths, out=starts[1:])
    data, indices = np.empty(entries), np.empty(entries, dtype=starts.dtype)
    for action, part in enumerate(parts):
        shift = starts[action:-1:count] - part.indptr[:-1]
        places = np.repeat(shift, lengths[:, action]) + np.arange(part.nnz)
        data[places], indices[places] = part.data, part.indices
    return csr((data, indices, starts), (size * count, size), copy=False)
