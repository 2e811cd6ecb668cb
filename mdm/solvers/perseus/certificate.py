"""The values of vectors as plans: the certificate of a policy.

Rounds leave out vectors that no point needs any more, though others were made of them; the greatest vector at a belief
then promises more than choosing by the vectors earns. Here the vectors become the nodes of a controller whose edges
lead to vectors that are still there: each observation to the best one at what the vector's own belief becomes. What the
controller earns is the solution of linear equations (E. A. Hansen, *Solving POMDPs by searching in policy space*, UAI
1998, section 3), approached by sweeps and then lowered until no vector is above what its backup says. So a backup
improves them at every belief, and whoever chooses by them earns at least what they say.

Where there are false negatives this holds for the controller, which goes along its edges. An agent that chooses by the
vectors at the belief of a tracker may earn a little less: a tracker's belief does not discount what took long.

A sweep costs P(s', o | s, a) times the vectors of each action.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.solvers.perseus.backup import Vectors, choose

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.limits import Limits
    from mdm.solvers.perseus.joint_dynamics import JointDynamics

__all__ = ["certified"]

_SWEEPS = 1000
_BLOCK = 64
_LATE = 0.5, 0.05
"""How long the last sweeps may take when the time is up: so many seconds, and such a share of the time before."""


def certified(dynamics: JointDynamics, points: Matrix, vectors: Vectors, precision: float, limits: Limits) -> Vectors:
    """Return the vectors as values that choosing by them earns, at least.

    Args:
        dynamics: The model.
        points: n x S.
        vectors: The vectors.
        precision: By how much they may be too low.
        limits: Ends the sweeps, a little after its time is up; the vectors are then the lower for it.
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
