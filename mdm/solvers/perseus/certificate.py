"""The certificate of a policy: the values of its vectors as plans, and an upper bound of all.

Rounds drop vectors that no point needs any more, though other vectors were made of them. The greatest vector at a
belief then promises more than the policy earns. Here the vectors become the nodes of a controller over the remaining
vectors: each observation leads to the best vector at the belief that follows the node's own. The controller's values
solve linear equations (E. A. Hansen, *Solving POMDPs by searching in policy space*, UAI 1998, section 3). They are
approached by sweeps, and then lowered until no vector exceeds its backup. So a backup improves them at every belief,
and the policy that chooses by them earns no less.

Where there are false negatives this holds for the controller, which goes along its edges. An agent that chooses by the
vectors at a tracker's belief may earn a little less: that belief does not discount long waits.

A sweep costs P(s', o | s, a) times the vectors of each action. The upper bound is the fast informed one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.solvers.bounds import informed_values
from mdm.solvers.perseus.backup import Vectors, choose

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.joint_dynamics import JointDynamics
    from mdm.solvers.solution import Limits

__all__ = ["certified", "upper_bound"]

_SWEEPS = 1000
_BLOCK = 64
_LATE = 0.5, 0.05
"""The last sweeps may take so many seconds, and such a share of the time before, when the time is up."""


def certified(dynamics: JointDynamics, points: Matrix, vectors: Vectors, precision: float, limits: Limits) -> Vectors:
    """Return the vectors, lowered to what a policy that chooses by them earns at least.

    Args:
        dynamics: The model.
        points: n x S.
        vectors: The vectors.
        precision: By how much they may be too low.
        limits: Ends the sweeps, a little after the time is up; the vectors are then lower.
    """
    groups = []
    for action in np.unique(vectors.actions).tolist():
        at = np.flatnonzero(vectors.actions == action)
        blocks = np.array_split(vectors.points[at], len(at) // _BLOCK + 1)
        chosen = [choose(dynamics, action, points[block], vectors.values).following for block in blocks]
        groups.append((action, at, np.concatenate(chosen)))

    def backed(values: Vector) -> Vector:
        result = np.empty_like(values)
        for action, at, following in groups:
            result[at] = dynamics.vectors(action, values, following)
        return result

    values = vectors.values
    began = limits.seconds
    for _ in range(_SWEEPS):
        better = backed(values)
        change = float(np.abs(better - values).max())
        values = better
        if change * dynamics.discount <= precision * (1 - dynamics.discount):
            break
        if limits.remaining < 0 and limits.seconds - began > _LATE[0] + _LATE[1] * began:
            break
    excess = max(float((values - backed(values)).max()), 0.0)
    return vectors._replace(values=values - excess / (1 - dynamics.discount))


def upper_bound(dynamics: JointDynamics, starts: Vector, limits: Limits, horizon: int | None = None) -> float:
    """Return an upper bound of the value at the start.

    Args:
        dynamics: The model.
        starts: The beliefs at the start, each times its probability: k x S.
        limits: Ends the sweeps. With a horizon there is then no bound but inf.
        horizon: How many decisions there are.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    informed = dynamics.informed
    if horizon is None:
        table = informed_values(dynamics.dynamics, limits, informed)
    else:
        table = np.zeros((dynamics.size, dynamics.num_actions))
        for _ in range(horizon):
            if limits.remaining < 0:
                return np.inf
            table = informed.backup(table)
    return float((starts @ table).max(axis=1).sum())
