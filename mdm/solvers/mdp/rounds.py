"""Rounds of sweeps and one backup that bounds the optimal values: what value iteration and its kin have in common.

With d = T V - V over all states, T the backup, the optimal values lie within

    T V + discount / (1 - discount) * [min d, max d],

and a policy that is greedy to V has at least the lower end as its value (J. B. MacQueen, *A modified dynamic
programming method for Markovian decision problems*, Journal of Mathematical Analysis and Applications 14, 1966; E. L.
Porteus, *Some bounds for discounted sequential decision processes*, Management Science 18, 1971). The bounds are as far
apart in every state. Any V will do: sweeps of any kind may come between. V moves on from the lower end of its bounds,
where T V >= V, so that it rises in all sweeps, also in those of a policy that is not the best.

Sweeps in place leave errors that differ from state to state by as much as they changed, which keeps the bounds apart
where the discount is near 1; backups of all states at once even them out. A few of these before the last make a round
worth hundreds without.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.policies import QTable
from mdm.solvers.mdp.backups import backup, sweep

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models.dynamics import Dynamics
    from mdm.models.matrices import Vector
    from mdm.solvers.limits import Limits
    from mdm.solvers.solution import Solution

__all__ = ["Round", "bounded", "rounding", "rounds", "sweeping", "sweeps_of"]

_PASS = 200_000
"""Entries that the sweeps of a round go over at least, so that its report costs little beside them."""
_SWEEPS = 3, 64
"""The least and the most sweeps of a round."""
_LEVELLING = 16
"""The most backups of a round that even errors out."""
_SETTLED = 0.3
"""Sweeps end when they change values by less than this share of what is unknown of them, in one step."""


class Round(NamedTuple):
    """Values and what a backup proves by them.

    Attributes:
        values: V, about the values of the states.
        backed: T V.
        policy: The greedy policy of V.
        below: The optimal value of each state is at least T V and this.
        above: It is at most T V and this.
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
        with np.errstate(all="ignore"):  # what overflows is refused by who watches the bounds
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
    """Return a Q-table with its bounds at a belief, from as many rounds as the limits allow."""
    for iterations, now in enumerate(rounds(dynamics, improve), 1):
        value = float(belief @ now.backed)
        lower, upper = value + now.below, value + now.above
        if limits.ends(lower, upper, iterations=iterations, size=dynamics.num_states):
            break
        if now.above - now.below <= rounding(dynamics, now):
            limits.reason = "converged"
            break
    return limits.solution(now.table(dynamics), solver, lower, upper, iterations=iterations, size=dynamics.num_states)


def rounding(dynamics: Dynamics, now: Round) -> float:
    """Return how near the bounds come: what sums of floats are off, over all steps to come."""
    terms = 16 + dynamics.entries / dynamics.rewards.size
    return float(terms * np.finfo(float).eps * np.abs(now.backed).max() / (1 - dynamics.discount))


def sweeping(dynamics: Dynamics, gap: float, each: int) -> Callable[[Vector, Round], None]:
    """Return sweeps for `rounds`.

    Args:
        dynamics: The model.
        gap: How far the bounds may be apart at the end.
        each: One of so many sweeps finds the best actions; see `mdm.solvers.mdp.backups.sweep`.
    """
    most = each * sweeps_of(dynamics)
    share = _SETTLED * (1 - dynamics.discount)

    def improve(values: Vector, last: Round) -> None:
        sweep(dynamics, values, last.policy, most, each, share * max(last.above - last.below, gap))

    return improve


def sweeps_of(dynamics: Dynamics) -> int:
    """Return how many sweeps for the best actions a round has: more of them in small models."""
    least, most = _SWEEPS
    return min(max(_PASS // dynamics.entries, least), most)
