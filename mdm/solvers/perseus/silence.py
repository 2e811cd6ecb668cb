"""What goes on unnoticed while an action is done, for as long as nothing is noticed.

With S(s, s') the probability of a step of which nothing is noticed, an action that earns r in a step earns
(I - g S)^-1 r until something is, g being the discount, and what is noticed at last is weighed by the same matrix
(J. V. Messias, M. T. J. Spaan and P. U. Lima, *Asynchronous execution in multiagent POMDPs: reasoning over
partially-observable events*, MSDM 2013). It is factorised once for each action.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.compressed import csr, csr_identity, is_compressed

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector

__all__ = ["Silence"]

_ROUNDING = 1e-5
"""What is missing to 1 of a step's probabilities and is no silence: files give them with six digits."""
_ENDLESS = 1e9


class Silence:
    """Applies (I - g S)^-1 to weights of states, and to values of states.

    Args:
        steps: S of one action, S x S', dense or CSR.
        discount: What a step is discounted by.
        name: The action's.

    Raises:
        ModelError: If the discount is 1 and nothing may ever be noticed.
    """

    def __init__(self, steps: Matrix, discount: float, name: str) -> None:
        self._inverse: Vector | None = None
        self._factors: Any = None
        size = steps.shape[0]
        endless = f"the discount is 1, and action {name!r} may go on for ever without anything being noticed"
        try:
            if is_compressed(steps):
                from scipy.sparse.linalg import splu  # noqa: PLC0415 - takes as long to import as all the rest

                self._factors = splu((csr_identity(size) - discount * steps).tocsc())
            else:
                self._inverse = np.linalg.inv(np.eye(size) - discount * steps)
        except (np.linalg.LinAlgError, RuntimeError):
            raise ModelError(endless) from None
        if not np.abs(self.values(np.ones(size))).max() < _ENDLESS / max(1 - discount, 1e-6):
            raise ModelError(endless)

    def weights(self, rows: Matrix) -> Matrix:
        """Return rows of weights times the matrix, of the same kind, dense or CSR."""
        if self._inverse is not None:
            return rows @ self._inverse
        if is_compressed(rows):
            return csr(self.weights(rows.toarray()))
        return np.ascontiguousarray(self._factors.solve(np.asarray(rows.T, order="F"), trans="T").T)

    def values(self, columns: Vector) -> Vector:
        """Return the matrix times columns of values."""
        if self._inverse is not None:
            return np.asarray(self._inverse @ columns)
        return np.asarray(self._factors.solve(columns))

    @staticmethod
    def of(transition: Matrix, noticed: list[Matrix], discount: float, name: str) -> Silence | None:
        """Return the silence of an action, from T and P(s', o | s, a) of what is noticed; None where there is none."""
        steps = transition - sum(noticed[1:], start=noticed[0])
        if is_compressed(steps):
            steps = csr(steps)
            steps.data = np.maximum(steps.data, 0.0)
            steps.eliminate_zeros()
        else:
            steps = np.maximum(steps, 0.0)
        if np.asarray(steps.sum(axis=1)).max() <= _ROUNDING:
            return None
        return Silence(steps, discount, name)
