"""The bounds that Perseus begins with: one action for ever from below, the fast informed bound from above.

Both are approached from the safe side, so that they hold wherever the sweeps end (M. Hauskrecht, *Value-function
approximations for partially observable Markov decision processes*, JAIR 13, 2000, section 4.5; *Incremental methods for
computing bounds in partially observable Markov decision processes*, AAAI 1997).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models.compressed import csr

if TYPE_CHECKING:
    from mdm.models.matrices import Vector
    from mdm.solvers.perseus.outlook import Outlook
    from mdm.solvers.watch import Watch

__all__ = ["blind_values", "upper_bound"]

_SWEEPS = 2_000
_SETTLED = 1e-6


def blind_values(outlook: Outlook) -> Vector:
    """Return what each action is worth, at least, if it is done for ever: A x S.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    result = np.empty_like(outlook.rewards)
    for action, rewards in enumerate(outlook.rewards):
        values = np.full(outlook.size, _limit(rewards.min(), outlook.discount))
        for _ in range(_SWEEPS):
            better = rewards + outlook.discount * (outlook.transitions[action] @ values)
            change = np.abs(better - values).max()
            values = better
            if change <= _SETTLED * np.ptp(rewards):
                break
        result[action] = values
    return result


def upper_bound(outlook: Outlook, starts: Vector, watch: Watch, horizon: int | None = None) -> float:
    """Return the fast informed bound: no policy earns more from the beliefs at the start.

    Args:
        outlook: The model.
        starts: The beliefs, each times its probability: k x S.
        watch: Ends the sweeps. Those of a horizon must not be ended: there is then no bound, but inf.
        horizon: How many decisions there are.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    values = np.zeros((outlook.num_actions, outlook.size)) if horizon is not None else _known_state(outlook, watch)
    rows = [outlook.apart(action, csr(matrix)) for action, matrix in enumerate(outlook.ahead)]
    for _ in range(_SWEEPS if horizon is None else horizon):
        if watch.remaining < 0:
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


def _known_state(outlook: Outlook, watch: Watch) -> Vector:
    """Return what actions are worth, at most, where the state is known after them: A x S."""
    values = np.full(outlook.size, _limit(outlook.rewards.max(), outlook.discount))
    for _ in range(_SWEEPS):
        table = np.stack([matrix @ values for matrix in outlook.transitions])
        table *= outlook.discount
        table += outlook.rewards
        better = table.max(axis=0)
        change = np.abs(better - values).max()
        values = better
        if change <= _SETTLED * np.ptp(values) or watch.remaining < 0:
            break
    return table


def _limit(reward: float, discount: float) -> float:
    """Return what a reward in every step is worth."""
    with np.errstate(over="ignore"):
        value = float(np.float64(reward) / (1 - discount))
    if not np.abs(value) < np.finfo(np.float64).max / 1e3:
        raise ModelError(f"a reward of {reward:g} in every step is too much for numbers: scale the rewards down")
    return value
