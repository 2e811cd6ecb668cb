"""Policy iteration, exact and modified: evaluate a policy, make it greedy to its values, repeat until it is stable.

`policy_iteration` (R. A. Howard, *Dynamic Programming and Markov Processes*, 1960) solves (I - discount P) V = R for
each policy, by dense or sparse LU: of up to S^3 operations, on a grid's sparse factors about S^1.5. It takes some ten
steps where rewards are near, whatever the discount, and as many as the path to them is long where they are far. Best
for small models, for discounts near 1, and for a discount of 1, where no other solver proves its result.

`modified_policy_iteration` (M. L. Puterman and M. C. Shin, *Modified policy iteration algorithms for discounted Markov
decision problems*, Management Science 24, 1978) evaluates a policy by a few sweeps over its own transitions, which
are A times cheaper than those of value iteration: the solver for large models.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.models.dynamics import Dynamics
from mdm.models.matrices import csr_identity, is_compressed
from mdm.policies import QTable
from mdm.solvers.mdp.rounds import bounded, sweeping
from mdm.solvers.mdp.undiscounted import first_policy, resting
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.solution import Solution

    Actions = npt.NDArray[np.intp]

__all__ = ["evaluate", "improve_policies", "modified_policy_iteration", "policy_iteration", "steps"]

_BETTER = 1e-11
"""An action replaces another if it is better by this share of what is added up for both: more than rounding."""
_OPEN = 1e-14
"""Rows of equations are solved once more if so large a share of what is added up in one of them is left open."""
_BACKUPS = 50
"""The backups between one evaluation and the next, where the discount is 1."""
_EACH = 15
"""One of so many sweeps finds the best actions. The number is odd, so that these go forward and backward in turn."""


@makes(QTable)
def policy_iteration(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the optimal values of a model's states, as a `QTable`; those of a POMDP's known states.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; its iterations are policies. With a gap of 0 the result is exact.

    Raises:
        ModelError: If the discount is 1, and the values have no bound.
    """
    with Limits() if limits is None else limits as run:
        return improve_policies(Dynamics(model), model.initial_belief, run, "policy-iteration")


@makes(QTable)
def modified_policy_iteration(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the optimal values of a model's states, as a `QTable`; those of a POMDP's known states.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; its iterations are rounds of sweeps, for one policy each.

    Raises:
        ModelError: If the discount is 1, and the values have no bound.
    """
    name = "modified-policy-iteration"
    with Limits() if limits is None else limits as run:
        dynamics = Dynamics(model)
        if dynamics.discount == 1:
            return improve_policies(dynamics, model.initial_belief, run, name)
        improve = sweeping(dynamics, run.gap, _EACH)
        return bounded(dynamics, model.initial_belief, run, name, improve)


class Step(NamedTuple):
    """A policy's exact values, and the next policy.

    Attributes:
        values: S.
        table: The values of actions, S x A.
        policy: The next policy: with other actions where these are better.
        upper: The optimal values exceed these by at most so much.
        stable: Whether the values are optimal: no action is better than the policy's own.
    """

    values: Vector
    table: Vector
    policy: Actions
    upper: float
    stable: bool


def steps(dynamics: Dynamics) -> Iterator[Step]:
    """Yield policies, each better than the last, until one is stable.

    The first is greedy to the rewards; with a discount of 1 it is one that comes to rest. Only a better action replaces
    an action: so with a discount of 1, a policy that never rests proves that rewards have no end. What is better is
    told by the numbers of the state itself, however much larger those of other states are.
    """
    endless = dynamics.discount == 1
    policy = first_policy(dynamics) if endless else dynamics.rewards.argmax(axis=1)
    states = np.arange(dynamics.num_states)
    stable = False
    before, better = np.full(dynamics.num_states, -np.inf), np.ones(dynamics.num_states, dtype=bool)
    while not stable:
        values = evaluate(dynamics, policy)
        rose = (values > before)[better].all()  # else what seemed better was rounding after all
        table = dynamics.q_values(values)
        best = table.argmax(axis=1)
        gains = table[states, best] - values
        with np.errstate(over="ignore"):  # values near the largest number: nothing is better by more
            parts = np.abs(dynamics.rewards) + dynamics.discount * dynamics.after(np.abs(values))
        # By how much the value of each action in each state (S x A) may be off, and more, by rounding.
        least = _BETTER * np.asarray(parts)
        better = table[states, best] - table[states, policy] > least[states, best] + least[states, policy]
        better &= rose
        before = values
        stable = not better.any()
        policy = np.where(better, best, policy)
        upper = np.inf if endless else float(gains.max()) / (1 - dynamics.discount)
        if endless and not stable:
            policy = _ahead(dynamics, values, policy, least)
        yield Step(values, table, policy, 0.0 if stable else upper, stable)


def _ahead(dynamics: Dynamics, values: Vector, policy: Actions, least: Vector) -> Actions:
    """Return a policy that some more backups have improved, from values that the policy's own are no lower than.

    They are much cheaper than an evaluation. Values only rise, so that an action that is better than the policy's own
    does not lead in a circle without an end, as it might among actions of equal values.
    """
    states = np.arange(dynamics.num_states)
    for _ in range(_BACKUPS):
        table = dynamics.q_values(values)
        best = table.argmax(axis=1)
        own = table[states, policy]
        better = table[states, best] - own > least[states, best] + least[states, policy] + _BETTER * np.abs(own)
        policy = np.where(better, best, policy)
        values = np.where(better, table[states, best], own)
    return policy


def improve_policies(dynamics: Dynamics, belief: Vector, limits: Limits, solver: str) -> Solution:
    """Return a Q-table with its bounds at a belief, of as many policies as the limits allow."""
    for iterations, step in enumerate(steps(dynamics), 1):
        lower = float(belief @ step.values)
        upper = lower + step.upper
        if limits.ends(lower, upper, iterations=iterations, size=dynamics.num_states):
            break
    table = step.table
    if dynamics.discount == 1:
        # Other actions of the policy's value may wait for ever: those with a lower index are lowered by their last bit.
        own = np.take_along_axis(table, step.policy[:, None], axis=1)
        before = np.arange(table.shape[1]) < step.policy[:, None]
        table = np.where(before, np.minimum(table, np.nextafter(own, -np.inf)), np.minimum(table, own))
    return limits.solution(
        QTable(table), solver, lower, upper, iterations=iterations, size=dynamics.num_states, exact=step.stable
    )


def evaluate(dynamics: Dynamics, policy: Actions) -> Vector:
    """Return the value of each state under a policy: the solution of (I - discount P) V = R.

    Raises:
        ModelError: If the discount is 1, and the policy's rewards have no end.
    """
    matrix, rewards = dynamics.under(policy)
    values = np.zeros(dynamics.num_states)
    moving = np.arange(dynamics.num_states)
    if dynamics.discount == 1:
        moving = np.flatnonzero(~resting(matrix, rewards, policy, dynamics))
        matrix, rewards = matrix[moving][:, moving], rewards[moving]
    if not len(moving):
        return values
    values[moving] = _solved(dynamics.discount * matrix, rewards)
    return values


def _solved(matrix: Matrix, rewards: Vector) -> Vector:
    """Return V with V = rewards + matrix V, each value as near as the numbers of its own row allow.

    The rows of large numbers spoil those of small ones where an elimination mixes them, unless what is left open in
    each row is solved once more (R. D. Skeel, *Iterative refinement implies numerical stability for Gaussian
    elimination*, Mathematics of Computation 35, 1980).
    """
    solve: Callable[[Vector], Vector]
    if is_compressed(matrix):
        from scipy.sparse.linalg import splu  # noqa: PLC0415 - imported where it is needed

        solve = splu((csr_identity(len(rewards)) - matrix).tocsc()).solve
    else:
        equations = np.eye(len(rewards)) - matrix
        solve = partial(np.linalg.solve, equations)
    values = solve(rewards)
    open_ = rewards + matrix @ values - values
    parts = np.abs(rewards) + matrix @ np.abs(values)
    if (np.abs(open_) > _OPEN * parts).any():
        values = values + solve(open_)
    return values
