"""Policies of upper bounds: QMDP and the fast informed bound, one alpha vector per action each.

QMDP acts as if the state were known after the next step: its vectors are the values Q(s, a) of the underlying MDP
(M. L. Littman, A. R. Cassandra and L. P. Kaelbling, *Learning policies for partially observable environments: scaling
up*, ICML 1995, section 3). They are upper bounds of the optimal value function, and never choose an action for its
information. The cost is that of the MDP, whatever the observations. Choose the fast informed bound where observations
tell little of the state, and SARSOP or Perseus where a policy must gather information before it acts.

The fast informed bound (see `mdm.solvers.bounds`) is at least as tight: the next action is chosen by the observation,
not by the state. Backups begin at QMDP's vectors and lower them, so that they are bounds at every step. Each costs A
times the entries of all P(s', o | s, a), up to O times as many as transitions. Choose QMDP where that is too much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.dynamics import Dynamics
from mdm.models.events import check_no_false_negatives
from mdm.policies import AlphaVectors
from mdm.solvers.bounds import InformedBound, known_states
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.models import MDP, POMDP
    from mdm.models.matrices import Vector
    from mdm.solvers.solution import Solution

__all__ = ["fast_informed_bound", "qmdp"]

_ROUNDING = 1e-14
"""Backups go on while they change the vectors by more than this share."""
_SETTLED = 1e-3
"""With a discount of 1, backups end when they change vectors by less than this share of the gap."""


@makes(AlphaVectors)
def qmdp(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the values of a POMDP's actions in known states, as `AlphaVectors`, one per action.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; the gap is how far the vectors may be from their limit, and the iterations are rounds of
            sweeps, or policies where the discount is 1.

    Returns:
        The vectors, which are an upper bound. Nothing is proven of their policy's value: ``lower`` is -inf. With a
        discount of 1 they are a bound only when they are exact; before, ``upper`` is inf.

    Raises:
        ModelError: If the discount is 1, and the values have no bound; or the model has false negatives.
    """
    check_no_false_negatives(model, "QMDP")
    with Limits() if limits is None else limits as run:
        dynamics = Dynamics(model)
        belief = model.initial_belief
        for iterations, (table, bounds) in enumerate(known_states(dynamics, run.gap), 1):
            upper = float((belief @ table).max()) if bounds else np.inf
            if run.ends(-np.inf, upper, iterations=iterations, size=dynamics.num_actions):
                break
        else:
            run.reason = "converged" if dynamics.discount < 1 else "exact"
        return run.solution(
            AlphaVectors(table.T, range(dynamics.num_actions), dynamics.num_actions),
            "qmdp",
            -np.inf,
            upper,
            iterations=iterations,
            size=dynamics.num_actions,
        )


@makes(AlphaVectors)
def fast_informed_bound(model: POMDP, *, limits: Limits | None = None) -> Solution:
    """Return an upper bound of a POMDP's value function as `AlphaVectors`, one per action.

    Args:
        model: The model, with observations of either kind; factored ones are flattened. Where observations of events do
            not sum to 1, the rest counts as one more observation.
        limits: When to stop; the gap is how far the vectors may be from their limit, and the iterations are backups,
            those for QMDP's vectors included.

    Returns:
        The vectors, which are an upper bound. Nothing is proven of their policy's value: ``lower`` is -inf. With a
        discount of 1 they are a bound only once QMDP's are exact; before, ``upper`` is inf.

    Raises:
        ModelError: If the discount is 1, and the values have no bound; or the model has false negatives.
    """
    check_no_false_negatives(model, "the fast informed bound")
    with Limits() if limits is None else limits as run:
        dynamics = Dynamics(model)
        count, belief = dynamics.num_actions, model.initial_belief
        for iterations, (table, bounds) in enumerate(_vectors(dynamics, run.gap), 1):
            upper = float((belief @ table).max()) if bounds else np.inf
            if run.ends(-np.inf, upper, iterations=iterations, size=count):
                break
        else:
            run.reason = "converged"
        return run.solution(
            AlphaVectors(table.T, range(count), count), "fib", -np.inf, upper, iterations=iterations, size=count
        )


def _vectors(dynamics: Dynamics, gap: float) -> Iterator[tuple[Vector, bool]]:
    """Yield vectors, S x A, ever lower, and whether they are bounds."""
    for table, bounds in known_states(dynamics, gap):
        yield table, bounds
    informed, table = InformedBound(dynamics), table.copy()
    slowness = dynamics.discount / (1 - dynamics.discount) if dynamics.discount < 1 else 1 / _SETTLED
    change = np.inf
    while slowness * change > gap and change > _ROUNDING * np.abs(table).max():
        change = informed.sweep(table)
        yield table, True
