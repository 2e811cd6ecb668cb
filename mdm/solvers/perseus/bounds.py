"""The upper bound of Perseus' certificate: the fast informed bound, of all the models that it solves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.solvers.bounds import informed_values

if TYPE_CHECKING:
    from mdm.models.matrices import Vector
    from mdm.solvers.joint_dynamics import JointDynamics
    from mdm.solvers.limits import Limits

__all__ = ["upper_bound"]


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
