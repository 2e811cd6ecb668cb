"""Prioritised sweeping: back up the states with the largest errors first, then their predecessors.

A state's priority bounds the change of its value. A backup raises the priorities of its predecessors to the discounted
probability of the transition times the change (A. W. Moore and C. G. Atkeson, *Prioritized sweeping*, Machine Learning
13, 1993). A falling threshold takes the place of a queue, which would cost more than the backups it saves (P. Dai and
E. A. Hansen, *Prioritizing Bellman backups without a priority queue*, ICAPS 2007). Rounds end with a backup of all
states, which bounds the values (see `mdm.solvers.mdp.rounds`).

It holds the transitions a second time, by their next states. Choose it where rewards are in few places and values
spread from there, as in mazes. Where all values change in each sweep, modified policy iteration is faster.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.dynamics import Dynamics, stacked
from mdm.models.matrices import csr
from mdm.policies import QTable
from mdm.solvers.mdp.policy_iteration import improve_policies
from mdm.solvers.mdp.rounds import Round, bounded, kernels, sweeps_of
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.solution import Solution

__all__ = ["prioritised_sweeping"]

_NAME = "prioritised-sweeping"
_SETTLED = 0.01
"""A round ends when priorities are below this share of the largest at its start."""


@makes(QTable)
def prioritised_sweeping(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the optimal values of a model's states, as a `QTable`; those of a POMDP's known states.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; its iterations are rounds, each of as many backups as a few sweeps.

    Raises:
        ModelError: If the discount is 1, and the values have no bound.
    """
    with Limits() if limits is None else limits as run:
        dynamics = Dynamics(model)
        if dynamics.discount == 1:
            return improve_policies(dynamics, model.initial_belief, run, _NAME)
        # The transitions by the states that they lead to: row s', column s, with an entry for each row of T.
        size = dynamics.num_states
        matrix = dynamics.transitions.matrix(size).T.tocsr()
        before = csr((matrix.data, matrix.indices % size, matrix.indptr), (size, size), copy=False)
        most = size * sweeps_of(dynamics)

        def improve(values: Vector, last: Round) -> None:
            # V at the lower end of its bounds: there a backup raises each value by its change above the least.
            priorities = last.backed - last.values
            values[:] = last.values + last.below / dynamics.discount
            priorities -= priorities.min()
            largest = float(priorities.max())
            _sweep(dynamics, values, priorities, before, largest / 2, _SETTLED * largest, most)

        return bounded(dynamics, model.initial_belief, run, _NAME, improve)


def _sweep(
    dynamics: Dynamics, values: Vector, priorities: Vector, before: Matrix, threshold: float, floor: float, most: int
) -> None:
    """Back up the states whose priority is above a threshold, in place, and halve it whenever there are none."""
    if (compiled := kernels(dynamics)) is not None:
        compiled.prioritised_sweeps(
            dynamics.transitions,
            dynamics.rewards,
            dynamics.discount,
            values,
            priorities,
            stacked([before]),
            threshold,
            floor,
            most,
        )
        return
    done = 0
    while threshold > floor and done < most:
        chosen = np.flatnonzero(priorities > threshold)
        done += len(chosen)
        if not len(chosen):
            threshold /= 2
            continue
        rows = dynamics.places[chosen].ravel()
        after = (dynamics.matrix[rows] @ values).reshape(-1, dynamics.num_actions)
        backed = (dynamics.rewards[chosen] + dynamics.discount * after).max(axis=1)
        change = np.abs(backed - values[chosen])
        values[chosen] = backed
        priorities[chosen] = 0
        leading = before[chosen]
        raised = dynamics.discount * leading.data * np.repeat(change, np.diff(leading.indptr))
        np.maximum.at(priorities, leading.indices, raised)
