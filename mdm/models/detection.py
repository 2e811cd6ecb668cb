"""Detection: steps in which nothing is detected, any number of which may precede an event that is.

Let H_o(s, s') = T(s, a, s') P(o | s, a, s'), and N be the steps without a detection: H_f of the false negative f, and
what events leave to no observation, T minus the sum of all H_o. Then the transition to the next detected event is one
step of H_o after 0, 1, 2, ... steps of N. The powers of N add up to its resolvent (I - N)^-1 (J. V. Messias, M. T. J.
Spaan and P. U. Lima, *Asynchronous execution in multiagent POMDPs: reasoning over partially-observable events*, MSDM
2013), which is factorised once per action.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import csr, csr_identity, is_compressed

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.mdp import MDP

__all__ = ["Resolvent", "check_no_false_negatives", "is_rounding", "leading_to_detection"]

_CERTAIN = 1e-12
_ROUNDING = 1e-5
"""Rows may sum to so much less than 1 by rounding alone: files give six digits."""


class Resolvent:
    """The resolvent (I - H)^-1 of a matrix H with row sums of at most 1: the sum of its powers from 0 on.

    A dense matrix is inverted, a CSR matrix factorised.

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
        # The transpose has no negative column sum, so it is factorised without row exchanges. Every entry is then a
        # sum of positive numbers, and exactly 0 between unconnected states.
        if not is_compressed(steps):
            self._inverse = np.linalg.inv((np.eye(steps.shape[0]) - steps).T).T
            return
        from scipy.sparse.linalg import splu  # noqa: PLC0415 - slow to import

        self._factors = splu((csr_identity(steps.shape[0]) - steps).T.tocsc())

    def weights(self, rows: Matrix) -> Matrix:
        """Return rows of weights times the resolvent, in the kind given: S or n x S numbers, dense or CSR."""
        if self._inverse is not None:
            return rows @ self._inverse
        if is_compressed(rows):
            return csr(self.weights(rows.toarray()))
        if rows.ndim == 1:
            return np.asarray(self._factors.solve(rows))
        return np.ascontiguousarray(self._factors.solve(np.asarray(rows.T, order="F")).T)

    def values(self, columns: Vector) -> Vector:
        """Return the resolvent times columns of values: S or S x n numbers, dense."""
        if self._inverse is not None:
            return np.asarray(self._inverse @ columns)
        return np.asarray(self._factors.solve(columns, trans="T"))

    def __reduce__(self) -> tuple[type[Resolvent], tuple[Matrix]]:
        """Support copies: factors of a CSR matrix cannot be copied, and are made anew."""
        return Resolvent, (self._steps,)


def is_rounding(steps: Matrix) -> bool:
    """Whether steps without a detection, S x S', are nothing but rounding."""
    return bool(np.asarray(steps.sum(axis=1)).max() <= _ROUNDING)


def leading_to_detection(joint: Matrix) -> Matrix:
    """Return steps without a detection, without the rows of states from which no event is ever detected.

    They contribute nothing to detected events, and would make I - N singular.

    Args:
        joint: P(s', nothing is detected | s, a) of an action, S x S', dense or CSR.
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
    """Refuse a model with false negatives, on behalf of a solver that does not support them.

    Raises:
        ModelError: If the model has any.
    """
    if model.false_negative is not None:
        raise ModelError(
            f"{solver} does not support false negatives: solve the model with sarsop or perseus, or without them "
            f"(model.with_false_negatives(None))"
        )
