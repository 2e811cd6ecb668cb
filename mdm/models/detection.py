"""False negatives: events that happen and are not detected, any number of them before the next that is.

With H_o(s, s') = T(s, a, s') P(o | s, a, s') and f the false negative, what leads to the next detected event is one
step of H_o after none, one, two, ... of H_f. The sum of the powers of H_f is its resolvent (I - H_f)^-1 (J. V. Messias,
M. T. J. Spaan and P. U. Lima, *Asynchronous execution in multiagent POMDPs: reasoning over partially-observable
events*, MSDM 2013). It is factorised once for each action, never summed term by term.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.compressed import csr, csr_identity, is_compressed

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.mdp import MDP

__all__ = ["Resolvent", "check_no_false_negatives", "leading_to_detection"]

_CERTAIN = 1e-12


class Resolvent:
    """(I - H)^-1 of a matrix H whose rows sum to at most 1: all that may happen in no, one, two, ... steps of it.

    A dense matrix is inverted, a CSR one factorised.

    Args:
        steps: H, S x S', dense or CSR.

    Raises:
        numpy.linalg.LinAlgError: If I - H, dense, has no inverse.
        RuntimeError: If I - H, CSR, has none.
    """

    def __init__(self, steps: Matrix) -> None:
        self._steps = steps
        self._inverse: Vector | None = None
        self._factors: Any = None
        # By its transpose, no column of which sums to less than 0: factorised without a row exchanged, it gives sums
        # of positive numbers alone, and where nothing leads exactly 0.
        if not is_compressed(steps):
            self._inverse = np.linalg.inv((np.eye(steps.shape[0]) - steps).T).T
            return
        from scipy.sparse.linalg import splu  # noqa: PLC0415 - takes as long to import as all the rest

        self._factors = splu((csr_identity(steps.shape[0]) - steps).T.tocsc())

    def weights(self, rows: Matrix) -> Matrix:
        """Return weights of states times the resolvent: one row of S, or n x S, dense or CSR; the same kind."""
        if self._inverse is not None:
            return rows @ self._inverse
        if is_compressed(rows):
            return csr(self.weights(rows.toarray()))
        if rows.ndim == 1:
            return np.asarray(self._factors.solve(rows))
        return np.ascontiguousarray(self._factors.solve(np.asarray(rows.T, order="F")).T)

    def values(self, columns: Vector) -> Vector:
        """Return the resolvent times values of states: S, or S x n, dense."""
        if self._inverse is not None:
            return np.asarray(self._inverse @ columns)
        return np.asarray(self._factors.solve(columns, trans="T"))

    def __reduce__(self) -> tuple[type[Resolvent], tuple[Matrix]]:
        """Let it be copied: the factors of a CSR matrix cannot be, but come again from the matrix."""
        return Resolvent, (self._steps,)


def leading_to_detection(joint: Matrix) -> Matrix:
    """Return H_f without the rows of the states from which no event is ever detected.

    From these nothing but false negatives follows: they add nothing to what is detected, and would leave I - H_f
    without an inverse.

    Args:
        joint: P(s', f | s, a) of the false negative and an action, S x S', dense or CSR.
    """
    leads = np.asarray(joint.sum(axis=1)).ravel() < 1 - _CERTAIN
    while True:
        wider = leads | (np.asarray(joint @ leads.astype(np.float64)) > 0)
        if (wider == leads).all():
            break
        leads = wider
    if not is_compressed(joint):
        return joint * leads[:, None]
    kept = csr((joint.data * np.repeat(leads, np.diff(joint.indptr)), joint.indices, joint.indptr), joint.shape)
    kept.eliminate_zeros()
    return kept


def check_no_false_negatives(model: MDP, solver: str) -> None:
    """Refuse a model with false negatives, for a solver that cannot plan for them.

    Raises:
        ModelError: If the model has any.
    """
    if model.false_negative is not None:
        raise ModelError(
            f"{solver} takes every event to be detected, but the model has false negatives: solve it with perseus, or "
            f"without them (model.with_false_negatives(None))"
        )
