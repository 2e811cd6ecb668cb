"""Policy iteration: evaluate a policy, make it greedy to its values, repeat until it is stable.

`policy_iteration` (R. A. Howard, *Dynamic Programming and Markov Processes*, 1960) solves (I - discount P) V = R for
each policy, by dense or sparse LU: of up to S^3 operations, on a grid's sparse factors about S^1.5. It takes some ten
steps where rewards are near, whatever the discount, and as many as the path to them is long where they are far. Best
for small models, for discounts near 1, and for a discount of 1, where no other solver proves its result.

With a discount of 1, a state *rests* where some action has no reward and leads to resting states alone. The total
reward of a model is finite if some policy comes to rest from every state (a stochastic shortest path: D. P. Bertsekas
and J. N. Tsitsiklis, *An analysis of stochastic shortest path problems*, Mathematics of Operations Research 16, 1991),
and no policy has rewards for ever. Policy iteration notices the latter by a policy that never rests.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import csr, csr_identity, is_compressed
from mdm.policies import QTable
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.solution import Solution

    Actions = npt.NDArray[np.intp]
    Mask = npt.NDArray[np.bool_]

_BETTER = 1e-11
"""An action replaces another if it is better by this share of the sums for both: more than rounding."""
_OPEN = 1e-14
"""Rows of equations are solved once more if so large a share of the sum in one of them is left open."""
_BACKUPS = 50
"""The backups between one evaluation and the next, where the discount is 1."""


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
    an action: so with a discount of 1, a policy that never rests proves that rewards have no end. The better action is
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

    The rows of large numbers spoil those of small ones where an elimination mixes them, unless the remainder of
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


# -- Coming to rest ----------------------------------------------------------------------------------------------------

_NAMED = 3
"""The most states that an error names."""


def remedy(model: MDP) -> str:
    """Return the way out for a model whose values have no bound, for the end of an error."""
    solver = "perseus" if model.kind == "POMDP" else "value-iteration"
    return f"give a discount below 1 (--discount), or plan for a horizon (--solver {solver} --horizon)"


def first_policy(dynamics: Dynamics) -> npt.NDArray[np.intp]:
    """Return a policy that comes to rest from every state.

    Raises:
        ModelError: If there is none; it names the states from which no policy comes to rest.
    """
    policy, rest = _rest(dynamics)
    rows, columns = _entries(dynamics.matrix)
    blocks, states = np.divmod(rows, dynamics.num_states)
    _, lowest = np.unique(dynamics.places[0], return_index=True)  # of the actions that share a matrix
    actions = lowest[blocks]
    reached, following = _leading_to(states, columns, rest)
    if not reached.all():
        first, *others = np.flatnonzero(~reached).tolist()
        names = dynamics.model.state_space.names
        also = f", nor from {_listed([repr(names[state]) for state in others])}" if others else ""
        raise ModelError(
            f"the discount is 1, but no policy comes to rest, where nothing more is earned or paid, from state "
            f"{names[first]!r}{also}: {remedy(dynamics.model)}"
        )
    towards = (columns == following[states]) & ~rest[states]
    policy[~rest] = dynamics.num_actions
    np.minimum.at(policy, states[towards], actions[towards])
    return policy


def resting(matrix: Matrix, rewards: Vector, policy: npt.NDArray[np.intp], dynamics: Dynamics) -> Mask:
    """Return the states from which a policy earns nothing more.

    Args:
        matrix: Its transitions.
        rewards: Its rewards.
        policy: Its action in each state.
        dynamics: The model.

    Raises:
        ModelError: If it never comes there from some state. Policy iteration takes up such a policy only where its
            rewards have no end: the error names a cycle of states and actions that has them.
    """
    states, columns = _entries(matrix)
    active, _ = _leading_to(states, columns, rewards != 0)
    reached, _ = _leading_to(states, columns, ~active)
    if not reached.all():
        model, cycle = dynamics.model, _cycle(matrix, ~reached)
        states, actions = model.state_space.names, model.action_space.names
        steps = _listed([f"{actions[policy[state]]!r} in {states[state]!r}" for state in cycle])
        raise ModelError(
            f"the discount is 1, and from state {states[cycle[0]]!r} rewards can be earned without end, by {steps} "
            f"again and again: {remedy(model)}"
        )
    return ~active


def _cycle(matrix: Matrix, endless: Mask) -> list[int]:
    """Return states of a policy, among some that it never leaves, that all lead to each other and nowhere else."""
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415 - imported where it is needed

    states = np.flatnonzero(endless)
    among = matrix[states][:, states]
    _, component = connected_components(csr(among), directed=True, connection="strong")
    rows, columns = _entries(among)
    left = component[rows[component[rows] != component[columns]]]
    cycle: list[int] = states[component == np.setdiff1d(component, left)[0]].tolist()
    return cycle


def _listed(names: list[str]) -> str:
    """Return the first names, and how many more there are, as words."""
    words = names[:_NAMED]
    if len(names) > _NAMED:
        words.append(f"{len(names) - _NAMED} more")
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _rest(dynamics: Dynamics) -> tuple[npt.NDArray[np.intp], Mask]:
    """Return an action by which each resting state rests, and which states these are."""
    free = dynamics.rewards == 0
    rest = free.any(axis=1)
    while True:
        leaves = dynamics.after((~rest).astype(np.float64)) > 0
        stays = free & ~leaves
        if (still := stays.any(axis=1) & rest).sum() == rest.sum():
            return stays.argmax(axis=1), rest
        rest = still


def _entries(matrix: Matrix) -> tuple[Any, Any]:
    """Return the rows and columns of the non-zeros."""
    if not is_compressed(matrix):
        rows, columns = np.nonzero(matrix)
        return rows, columns
    filled = matrix.data > 0
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))[filled], matrix.indices[filled]


def _leading_to(states: Any, next_states: Any, targets: Mask) -> tuple[Mask, npt.NDArray[np.intp]]:
    """Return the states from which transitions lead to targets, and the next state on the shortest way there."""
    from scipy.sparse.csgraph import breadth_first_order  # noqa: PLC0415 - imported where it is needed

    size = len(targets)
    ends = np.flatnonzero(targets)
    # Backwards from one more node, which the targets lead to.
    heads, tails = np.concatenate([next_states, np.full(len(ends), size)]), np.concatenate([states, ends])
    order = np.argsort(heads, kind="stable")
    starts = np.concatenate(([0], np.cumsum(np.bincount(heads, minlength=size + 1))))
    graph = csr((np.ones(len(order)), tails[order], starts), (size + 1, size + 1))
    found, before = breadth_first_order(graph, size, directed=True, return_predecessors=True)
    reached = np.zeros(size + 1, dtype=bool)
    reached[found] = True
    return reached[:size], before[:size].astype(np.intp)
