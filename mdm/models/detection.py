"""False negatives: events that happen and go unnoticed, any number of them before the next that is noticed.

With H_o(s, s') = T(s, a, s') P(o | s, a, s') and f the symbol for "nothing was detected", what leads to the next
noticed event is one step of H_o after none, one, two, ... of H_f: the sum of the powers of H_f is (I - H_f)^-1
(J. V. Messias, M. T. J. Spaan and P. U. Lima, *Asynchronous execution in multiagent POMDPs: reasoning over
partially-observable events*, MSDM 2013). The matrix is factorised once for each action, never summed term by term.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models.compressed import is_compressed

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector

__all__ = ["Unnoticed"]

_CERTAIN = 1e-12


class Unnoticed:
    """Moves beliefs along all that may have happened unnoticed while one action went on.

    Args:
        joint: P(s', f | s, a) of the action, S x S', dense or CSR.
    """

    def __init__(self, joint: Matrix) -> None:
        self._inverse: Vector | None = None
        self._factors: Any = None
        heard = _ever_heard_of(joint)
        if not is_compressed(joint):
            # By its transpose, no column of which sums to less than 0: factorised without a row exchanged, it gives
            # sums of positive numbers alone, and where nothing leads exactly 0.
            self._inverse = np.linalg.inv((np.eye(len(heard)) - joint * heard[:, None]).T).T
            return
        from scipy.sparse import diags_array, eye_array  # noqa: PLC0415 - takes as long to import as all the rest
        from scipy.sparse.linalg import splu  # noqa: PLC0415

        system = eye_array(len(heard)) - diags_array(heard.astype(np.float64)) @ joint
        self._factors = splu(system.T.tocsc())

    def before(self, joint: Vector) -> Vector:
        """Return (I - H_f)^-1 times a dense S x S' matrix: what is unnoticed, then what the matrix says."""
        assert self._inverse is not None
        return np.asarray(self._inverse @ joint)

    def __call__(self, belief: Vector) -> Vector:
        """Return belief times (I - H_f)^-1, S numbers that need not sum to 1."""
        if self._inverse is not None:
            return np.asarray(belief.dot(self._inverse))
        return np.asarray(self._factors.solve(belief))


def _ever_heard_of(joint: Matrix) -> Any:
    """Return in which states something may come to be noticed at last.

    From the others nothing ever follows but unnoticed events. They would make the matrix singular, and add nothing to
    what is noticed: their rows are left out.
    """
    heard = np.asarray(joint.sum(axis=1)).ravel() < 1 - _CERTAIN
    while True:
        wider = heard | (np.asarray(joint @ heard.astype(np.float64)) > 0)
        if (wider == heard).all():
            return heard
        heard = wider
