"""Value iteration and its kin: rounds of sweeps, each ended by a backup that bounds the optimal values.

In a backup of all states V(s) becomes the greatest R(s, a) + discount * the expected V of the next state. CSR matrices
are swept by compiled kernels where there is numba, each state with the newest values of the others (Gauss-Seidel).
Without numba, and for dense matrices, all states are backed up at once by scipy's and BLAS's products (Jacobi), which
takes more sweeps to the same values. A backup costs one pass over the transitions, S A times the successors of a state.

With d = T V - V over all states, T the backup, the optimal values lie within

    T V + discount / (1 - discount) * [min d, max d],

and a policy that is greedy to V has at least the lower end as its value (J. B. MacQueen, *A modified dynamic
programming method for Markovian decision problems*, Journal of Mathematical Analysis and Applications 14, 1966; E. L.
Porteus, *Some bounds for discounted sequential decision processes*, Management Science 18, 1971). The bounds are
equally far apart in every state. They hold for any V: sweeps of any kind may come between. V goes on from the lower end
of its bounds, where T V >= V, so that it rises in all sweeps, also in those of a policy that is not optimal.
Sweeps in place leave errors that differ from state to state, which keeps the bounds apart where the discount is near 1.
Backups of all states at once even them out: a few of these at the end of a round save hundreds of rounds.

`value_iteration` sweeps for the best actions each time (M. L. Puterman, *Markov Decision Processes*, 1994, section
6.3.3); the error falls at least by the discount in each sweep. To a horizon H there are H backups from the last stage
to the first (R. Bellman, *Dynamic Programming*, 1957), exact; the policy holds S A numbers a stage.

`modified_policy_iteration` (M. L. Puterman and M. C. Shin, *Modified policy iteration algorithms for discounted Markov
decision problems*, Management Science 24, 1978) evaluates a policy by a few sweeps over its own transitions, which
are A times cheaper than those of value iteration: the solver for large models.

`prioritised_sweeping` backs up the states with the largest errors first, then their predecessors. A state's priority
bounds the change of its value. A backup raises the priorities of its predecessors to the discounted probability of the
transition times the change (A. W. Moore and C. G. Atkeson, *Prioritized sweeping*, Machine Learning 13, 1993). A
falling threshold takes the place of a queue, which would cost more than the backups it saves (P. Dai and E. A. Hansen,
*Prioritizing Bellman backups without a priority queue*, ICAPS 2007). It holds the transitions a second time, by their
next states. Choose it where rewards are in few places and values spread from there, as in mazes; where all values
change in each sweep, modified policy iteration is faster.

With a discount of 1 and no horizon a backup does not bound the optimal values: policy iteration then solves the model,
if it comes to rest at all.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.compilation import can_compile
from mdm.errors import ConfigError
from mdm.models.dynamics import Dynamics, stacked
from mdm.models.matrices import csr
from mdm.policies import QTable, StagedPolicy
from mdm.solvers.mdp.policy_iteration import improve_policies
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.dynamics import Indices
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.solution import Solution

_PASS = 200_000
"""The sweeps of a round read at least so many entries, so that a report costs little beside them."""
_SWEEPS = 3, 64
"""The least and the most sweeps of a round."""
_LEVELLING = 16
"""The most backups of all states at once in a round."""
_SETTLED = 0.3
"""Sweeps end when they change values by less than this share of the gap between their bounds."""
_EACH = 15
"""One of so many sweeps finds the best actions. It is odd, so that these go forward and backward in turn."""
_FLOOR = 0.01
"""A round of prioritised sweeping ends when priorities are below this share of the largest at its start."""


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


def rounding(dynamics: Dynamics, now: Round) -> float:
    """Return how near the bounds can come: the rounding errors of a sum, over all steps to come."""
    terms = 16 + dynamics.entries / dynamics.rewards.size
    return float(terms * np.finfo(float).eps * np.abs(now.backed).max() / (1 - dynamics.discount))


def sweeping(dynamics: Dynamics, gap: float, each: int) -> Callable[[Vector, Round], None]:
    """Return sweeps for `rounds`.

    Args:
        dynamics: The model.
        gap: How far the bounds may be apart at the end.
        each: One of so many sweeps finds the best actions; see `mdm.solvers.mdp.value_iteration.sweep`.
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


# -- Solvers -----------------------------------------------------------------------------------------------------------


def _solved(
    model: MDP,
    limits: Limits | None,
    solver: str,
    improving: Callable[[Dynamics, float], Callable[[Vector, Round], None]],
) -> Solution:
    """Return a Q-table with its bounds at the initial belief, from as many rounds as the limits allow.

    The effect of rounding is left between the bounds. With a discount of 1 policy iteration takes their place.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop.
        solver: The solver's name.
        improving: Returns its sweeps for `rounds`, of a model's dynamics and the gap.
    """
    with Limits() if limits is None else limits as run:
        dynamics, belief = Dynamics(model), model.initial_belief
        if dynamics.discount == 1:
            return improve_policies(dynamics, belief, run, solver)
        size = dynamics.num_states
        for iterations, now in enumerate(rounds(dynamics, improving(dynamics, run.gap)), 1):
            value, error = float(belief @ now.backed), rounding(dynamics, now)
            lower, upper = value + now.below - error, value + now.above + error
            if run.ends(lower, upper, iterations=iterations, size=size):
                break
            if now.above - now.below <= error:
                run.reason = "converged"
                break
        return run.solution(now.table(dynamics), solver, lower, upper, iterations=iterations, size=size)


@makes(QTable)
def modified_policy_iteration(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the optimal values of a model's states, as a `QTable`; those of a POMDP's known states.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; its iterations are rounds of sweeps, for one policy each.

    Raises:
        ModelError: If the discount is 1, and the values have no bound.
    """
    return _solved(model, limits, "modified-policy-iteration", partial(sweeping, each=_EACH))


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
    if horizon is None:
        return _solved(model, limits, "value-iteration", partial(sweeping, each=1))
    with Limits() if limits is None else limits as run:
        return _backward(Dynamics(model), model.initial_belief, run, horizon)


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
        StagedPolicy(tables),
        "value-iteration",
        lower,
        upper,
        iterations=done,
        size=horizon * dynamics.num_states,
        exact=not stage,
    )


@makes(QTable)
def prioritised_sweeping(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the optimal values of a model's states, as a `QTable`; those of a POMDP's known states.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; its iterations are rounds, each of as many backups as a few sweeps.

    Raises:
        ModelError: If the discount is 1, and the values have no bound.
    """
    return _solved(model, limits, "prioritised-sweeping", _prioritised)


def _prioritised(dynamics: Dynamics, _gap: float) -> Callable[[Vector, Round], None]:
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
        _sweep(dynamics, values, priorities, before, largest / 2, _FLOOR * largest, most)

    return improve


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
