"""Backups of all states: V(s) becomes the greatest R(s, a) + discount * the expected V of the next state.

CSR matrices are swept by compiled kernels where there is numba, each state with the newest values of the others
(Gauss-Seidel). Without numba, and for dense matrices, all states are backed up at once by scipy's and BLAS's products
(Jacobi), which takes more sweeps to the same values. A backup costs one pass over the transitions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models.compilation import can_compile

if TYPE_CHECKING:
    from mdm.models.dynamics import Dynamics, Indices
    from mdm.models.matrices import Vector

__all__ = ["backup", "kernels", "sweep"]


def kernels(dynamics: Dynamics) -> Any:
    """Return the module of compiled sweeps; None for a dense model, and without numba."""
    if dynamics.is_dense or not can_compile():
        return None
    from mdm.solvers.mdp import sweeps  # noqa: PLC0415 - imports numba

    return sweeps


def backup(dynamics: Dynamics, values: Vector) -> tuple[Vector, Indices]:
    """Return each state's value after a backup, and its best action; of equal ones the lowest."""
    compiled = kernels(dynamics)
    if compiled is None:
        table = dynamics.q_values(values)
        policy = table.argmax(axis=1)
        return table[np.arange(dynamics.num_states), policy], policy
    backed, policy = np.empty(dynamics.num_states), np.empty(dynamics.num_states, dtype=np.intp)
    compiled.backup(dynamics.transitions, dynamics.rewards, dynamics.discount, values, backed, policy)
    return backed, policy


def sweep(dynamics: Dynamics, values: Vector, policy: Indices, most: int, each: int, tolerance: float) -> None:
    """Back states up, in place, until a sweep for the best actions changes none by more than the tolerance.

    Args:
        dynamics: The model.
        values: The values of the states.
        policy: An action for each state; about the best at the end.
        most: The most sweeps.
        each: One of so many sweeps finds the best actions, the first among them; the others follow these.
        tolerance: When to stop before.
    """
    compiled = kernels(dynamics)
    if compiled is not None:
        compiled.sweep(dynamics.transitions, dynamics.rewards, dynamics.discount, values, policy, most, each, tolerance)
        return
    matrix, rewards = dynamics.matrix, dynamics.rewards
    for turn in range(most):
        if turn % each == 0:
            backed, policy[:] = backup(dynamics, values)
            change = np.abs(backed - values).max()
            if each > 1:
                matrix, rewards = dynamics.under(policy)
        else:
            backed = rewards + dynamics.discount * (matrix @ values)
        values[:] = backed
        if turn % each == 0 and not change > tolerance:
            return
