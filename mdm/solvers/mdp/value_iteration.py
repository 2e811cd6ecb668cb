"""Value iteration: sweeps of backups until the bounds on the optimal values meet; backward induction to a horizon.

Infinite horizon: rounds of Gauss-Seidel sweeps (M. L. Puterman, *Markov Decision Processes*, 1994, section 6.3.3), each
round ended by a backup that bounds the optimal values (see `mdm.solvers.mdp.rounds`). A sweep costs one pass over the
transitions, S A times the successors of a state; the error falls at least by the discount in each. Modified policy
iteration needs fewer passes where there are many actions; policy iteration suits small models and discounts near 1.

Finite horizon H: H backups from the last stage to the first (R. Bellman, *Dynamic Programming*, 1957), exact; the
policy holds S A numbers a stage.

With a discount of 1 and no horizon a backup does not bound the optimal values: policy iteration then solves the model,
if it comes to rest at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ConfigError
from mdm.models.dynamics import Dynamics
from mdm.policies import QTable, StagedPolicy
from mdm.solvers.mdp.policy_iteration import improve_policies
from mdm.solvers.mdp.rounds import bounded, sweeping
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.solvers.solution import Solution

__all__ = ["value_iteration"]

_NAME = "value-iteration"


@makes(QTable, to_horizon=StagedPolicy)
def value_iteration(model: MDP, *, limits: Limits | None = None, horizon: int | None = None) -> Solution:
    """Return the optimal values of a model's states, as a `QTable`; those of a POMDP's known states.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; its iterations are rounds of a few sweeps, or stages where there is a horizon.
        horizon: How many decisions there are. The policy is a `StagedPolicy`, with a Q-table for each. Where the
            solver has to stop early, the stages that it did not reach get the table of the last one that it did.

    Raises:
        ModelError: If the discount is 1, there is no horizon, and the values have no bound.
        ConfigError: If the horizon is not positive.
    """
    if horizon is not None and horizon < 1:
        raise ConfigError(f"a horizon is a number of decisions from 1 on, not {horizon}", key="horizon")
    with Limits() if limits is None else limits as run:
        dynamics = Dynamics(model)
        if horizon is not None:
            return _backward(dynamics, model.initial_belief, run, horizon)
        if dynamics.discount == 1:
            return improve_policies(dynamics, model.initial_belief, run, _NAME)
        improve = sweeping(dynamics, run.gap, 1)
        return bounded(dynamics, model.initial_belief, run, _NAME, improve)


def _backward(dynamics: Dynamics, belief: Vector, limits: Limits, horizon: int) -> Solution:
    """Return the optimal policy of each stage, from the last to the first.

    While stages are missing the value is bounded by the least and the greatest reward in each of them.
    """
    tables = np.empty((horizon, dynamics.num_states, dynamics.num_actions))
    rewards = dynamics.rewards.min(), dynamics.rewards.max()
    values = np.zeros(dynamics.num_states)
    for stage in range(horizon - 1, -1, -1):
        tables[stage] = dynamics.q_values(values)
        values = tables[stage].max(axis=1)
        lower = upper = float(belief @ values)
        if stage:
            ahead = dynamics.discount**stage
            sums = stage if dynamics.discount == 1 else (1 - ahead) / (1 - dynamics.discount)
            lower = float(sums * rewards[0] + ahead * values.min())
            upper = float(sums * rewards[1] + ahead * values.max())
        if limits.ends(lower, upper, iterations=horizon - stage, size=horizon * dynamics.num_states):
            break
    tables[:stage] = tables[stage]
    done = horizon - stage
    return limits.solution(
        StagedPolicy(tables), _NAME, lower, upper, iterations=done, size=horizon * dynamics.num_states, exact=not stage
    )
