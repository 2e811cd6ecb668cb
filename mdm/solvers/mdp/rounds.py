"""Rounds of value iteration and its kin: some sweeps, then one backup that bounds the optimal values.

In a backup of all states V(s) becomes the greatest R(s, a) + discount * the expected V of the next state. CSR matrices
are swept by compiled kernels where there is numba, each state with the newest values of the others (Gauss-Seidel).
Without numba, and for dense matrices, all states are backed up at once by scipy's and BLAS's products (Jacobi), which
takes more sweeps to the same values. A backup costs one pass over the transitions.

With d = T V - V over all states, T the backup, the optimal values lie within

    T V + discount / (1 - discount) * [min d, max d],

and a policy that is greedy to V has at least the lower end as its value (J. B. MacQueen, *A modified dynamic
programming method for Markovian decision problems*, Journal of Mathematical Analysis and Applications 14, 1966; E. L.
Porteus, *Some bounds for discounted sequential decision processes*, Management Science 18, 1971). The bounds are
equally far apart in every state. They hold for any V: sweeps of any kind may come between. V goes on from the lower end
of its bounds, where T V >= V, so that it rises in all sweeps, also in those of a policy that is not optimal.

Sweeps in place leave errors that differ from state to state, which keeps the bounds apart where the discount is near 1.
Backups of all states at once even them out: a few of these at the end of a round save hundreds of rounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.compilation import can_compile
from mdm.policies import QTable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models.dynamics import Dynamics, Indices
    from mdm.models.matrices import Vector
    from mdm.solvers.solution import Limits, Solution

__all__ = ["Round", "backup", "bounded", "kernels", "rounding", "rounds", "sweep", "sweeping", "sweeps_of"]

_PASS = 200_000
"""The sweeps of a round read at least so many entries, so that a report costs little beside them."""
_SWEEPS = 3, 64
"""The least and the most sweeps of a round."""
_LEVELLING = 16
"""The most backups of all states at once in a round."""
_SETTLED = 0.3
"""Sweeps end when they change values by less than this share of the gap between their bounds."""


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


class Round(NamedTuple):
    """Values, and the bounds that a backup of them proves.

    Attributes:
        values: V, about the values of the states.
        backed: T V.
        policy: The greedy policy of V.
        below: The optimal values are at least T V + below.
        above: They are at most T V + above.
    """

    values: Vector
    backed: Vector
    policy: npt.NDArray[np.intp]
    below: float
    above: float

    def table(self, dynamics: Dynamics) -> QTable:
        """Return the values of actions, in the middle of their bounds."""
        return QTable(dynamics.q_values(self.values) + (self.below + self.above) / 2)


def rounds(dynamics: Dynamics, improve: Callable[[Vector, Round], None]) -> Iterator[Round]:
    """Yield round after round, from values of 0 on; the discount is less than 1.

    Args:
        dynamics: The model.
        improve: Sweeps over values, in place, between one backup and the next.
    """
    ahead = dynamics.discount / (1 - dynamics.discount)
    levelling = min(sweeps_of(dynamics), _LEVELLING)
    values = np.zeros(dynamics.num_states)
    while True:
        backed, policy = backup(dynamics, values)
        with np.errstate(all="ignore"):  # the limits refuse bounds that overflow
            change = backed - values
            now = Round(values, backed, policy, ahead * float(change.min()), ahead * float(change.max()))
        yield now
        values = backed + now.below
        improve(values, now)
        for _ in range(levelling):
            values, _ = backup(dynamics, values)


def bounded(
    dynamics: Dynamics, belief: Vector, limits: Limits, solver: str, improve: Callable[[Vector, Round], None]
) -> Solution:
    """Return a Q-table with its bounds at a belief, from as many rounds as the limits allow.

    What rounding may have done is left between the bounds.
    """
    for iterations, now in enumerate(rounds(dynamics, improve), 1):
        value, error = float(belief @ now.backed), rounding(dynamics, now)
        lower, upper = value + now.below - error, value + now.above + error
        if limits.ends(lower, upper, iterations=iterations, size=dynamics.num_states):
            break
        if now.above - now.below <= error:
            limits.reason = "converged"
            break
    return limits.solution(now.table(dynamics), solver, lower, upper, iterations=iterations, size=dynamics.num_states)


def rounding(dynamics: Dynamics, now: Round) -> float:
    """Return how near the bounds can come: the rounding errors of a sum, over all steps to come."""
    terms = 16 + dynamics.entries / dynamics.rewards.size
    return float(terms * np.finfo(float).eps * np.abs(now.backed).max() / (1 - dynamics.discount))


def sweeping(dynamics: Dynamics, gap: float, each: int) -> Callable[[Vector, Round], None]:
    """Return sweeps for `rounds`.

    Args:
        dynamics: The model.
        gap: How far the bounds may be apart at the end.
        each: One of so many sweeps finds the best actions; see `mdm.solvers.mdp.rounds.sweep`.
    """
    most = each * sweeps_of(dynamics)
    share = _SETTLED * (1 - dynamics.discount)

    def improve(values: Vector, last: Round) -> None:
        sweep(dynamics, values, last.policy, most, each, share * max(last.above - last.below, gap))

    return improve


def sweeps_of(dynamics: Dynamics) -> int:
    """Return the number of sweeps for the best actions in a round: more in small models."""
    least, most = _SWEEPS
    return min(max(_PASS // dynamics.entries, least), most)
