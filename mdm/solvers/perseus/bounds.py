"""The upper bound that Perseus is measured by: the fast informed bound, of all the models that it solves.

It is approached from above, so that it holds wherever the sweeps end (M. Hauskrecht, *Value-function approximations for
partially observable Markov decision processes*, JAIR 13, 2000, section 4.5).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.compressed import csr
from mdm.policies.blind_policy import for_ever

if TYPE_CHECKING:
    from mdm.models.matrices import Vector
    from mdm.solvers.limits import Limits
    from mdm.solvers.perseus.outlook import Outlook

__all__ = ["upper_bound"]

_SWEEPS = 2_000
_SETTLED = 1e-6


def upper_bound(outlook: Outlook, starts: Vector, limits: Limits, horizon: int | None = None) -> float:
    """Return the fast informed bound: no policy earns more from the beliefs at the start.

    Args:
        outlook: The model.
        starts: The beliefs, each times its probability: k x S.
        limits: Ends the sweeps. Those of a horizon must not be ended: there is then no bound, but inf.
        horizon: How many decisions there are.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    values = np.zeros((outlook.num_actions, outlook.size)) if horizon is not None else _known_state(outlook, limits)
    rows = [outlook.apart(action, csr(matrix)) for action, matrix in enumerate(outlook.ahead)]
    for _ in range(_SWEEPS if horizon is None else horizon):
        if limits.remaining < 0:
            if horizon is not None:
                return np.inf
            break
        columns = np.ascontiguousarray(values.T)
        better = np.empty_like(values)
        for action, (matrix, places) in enumerate(rows):
            ahead = np.bincount(places // outlook.width, (matrix @ columns).max(axis=1), minlength=outlook.size)
            better[action] = outlook.earned(action, outlook.rewards[action] + outlook.discount * ahead)
        change = np.abs(better - values).max()
        values = better if horizon is not None else np.minimum(better, values)
        if horizon is None and change <= _SETTLED * np.ptp(values):
            break
    return float((starts @ values.T).max(axis=1).sum())


def _known_state(outlook: Outlook, limits: Limits) -> Vector:
    """Return what actions are worth, at most, where the state is known after them: A x S."""
    values = np.full(outlook.size, for_ever(outlook.rewards.max(), outlook.discount))
    for _ in range(_SWEEPS):
        table = np.stack([matrix @ values for matrix in outlook.transitions])
        table *= outlook.discount
        table += outlook.rewards
        better = table.max(axis=0)
        change = np.abs(better - values).max()
        values = better
        if change <= _SETTLED * np.ptp(values) or limits.remaining < 0:
            break
    return table
