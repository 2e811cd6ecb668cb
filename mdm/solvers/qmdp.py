"""QMDP: act as if the state were known after the next step.

The values Q(s, a) of the underlying MDP are the alpha vectors of a POMDP's policy, one per action (M. L. Littman, A. R.
Cassandra and L. P. Kaelbling, *Learning policies for partially observable environments: scaling up*, ICML 1995, section
3). They are upper bounds of the optimal value function, and never choose an action for its information. The cost is
that of the MDP, whatever the observations. Choose the fast informed bound where observations tell little of the state,
and SARSOP or Perseus where a policy must gather information before it acts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.dynamics import Dynamics
from mdm.models.events import check_no_false_negatives
from mdm.policies import AlphaVectors
from mdm.solvers.bounds import known_states
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.solvers.solution import Solution

__all__ = ["qmdp"]


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
