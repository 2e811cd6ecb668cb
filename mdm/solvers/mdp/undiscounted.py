"""Models with a discount of 1: whether they come to rest, and a policy that brings them there.

A state *rests* where some action has no reward and leads to resting states alone. The total reward of a model
is finite if some policy comes to rest from every state (a stochastic shortest path: D. P. Bertsekas and J. N.
Tsitsiklis, *An analysis of stochastic shortest path problems*, Mathematics of Operations Research 16, 1991), and no
policy has rewards for ever. Policy iteration notices the latter by a policy that never rests.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import csr, is_compressed

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.dynamics import Dynamics
    from mdm.models.matrices import Matrix, Vector

    Mask = npt.NDArray[np.bool_]

__all__ = ["first_policy", "remedy", "resting"]

_NAMED = 3
"""The most states that an error names."""


def remedy(model: MDP) -> str:
    """Return what to do about a model whose values have no bound, for the end of an error."""
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
            f"the discount is 1, but from state {names[first]!r} no policy comes to where nothing more is earned or "
            f"paid{also}: {remedy(dynamics.model)}"
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
