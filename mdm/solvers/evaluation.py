"""Exact values of policies that need no belief: tables over states, and finite-state controllers.

A policy turns its model into a Markov chain with rewards, whose discounted total solves x = r + g P x: over the states
for a table (R. A. Howard, *Dynamic programming and Markov processes*, 1960), over pairs of a node and a state for a
controller (E. A. Hansen, *Solving POMDPs by searching in policy space*, UAI 1998, equation 2). Small systems are solved
by elimination, O(n^3); large ones, in CSR, by BiCGSTAB or by iteration, until the residual proves an error below 1e-9
of the values. For a number of decisions the equation is applied as often, from the last one back.

A policy over beliefs has no such chain: simulate it, with `mdm.evaluate`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP, in_time
from mdm.models.matrices import csr, csr_identity, is_compressed
from mdm.models.units import check_steps
from mdm.policies import mismatch

if TYPE_CHECKING:
    from mdm.models import MDP, Durations
    from mdm.models.matrices import Matrix, Vector
    from mdm.policies import FiniteStateController, StatePolicy

_DENSE = 1_000
_EXACT = 1e-9
_SIZE = 500_000
"""Pairs of a node and a state up to which a controller is evaluated."""


def exact_values(
    model: MDP, policy: Any, *, steps: int | None = None, durations: Durations | None = None
) -> Vector | None:
    """Return the exact value of a policy from each state; None where only simulation can tell.

    A controller begins in its start node or, if it has values of its nodes, in that which is best at the model's
    initial belief.

    Args:
        model: The model.
        policy: The policy.
        steps: Decisions; by default there is no end.
        durations: How long actions take, and how much they earn by time.

    Raises:
        ModelError: If the values have no bound, or the durations do not fit the model.
    """
    if durations is None:
        check_steps(model)
    if getattr(policy, "input", None) == "state":
        return None if not hasattr(policy, "weights") else state_values(model, policy, steps=steps, durations=durations)
    if model.pomdp is None or not hasattr(policy, "joined"):
        return None
    controller: FiniteStateController | None = policy.joined()
    if controller is None or controller.num_nodes * len(model.state_space) > _SIZE:
        return None
    if durations is None:
        values = controller_values(model.pomdp, controller, steps=steps)
    else:
        values = controller_values(in_time(model.pomdp, durations), controller, steps=steps)[:, :-1]
    start = controller.start if controller.values is None else controller.start_node(model.initial_belief)
    from_start: Vector = values[start]
    return from_start


def state_values(
    model: MDP, policy: StatePolicy, *, steps: int | None = None, durations: Durations | None = None
) -> Vector:
    """Return the value of a policy over states from each state: S numbers.

    Args:
        model: The model; the states of a POMDP are taken as known.
        policy: The policy, by its ``weights``.
        steps: Decisions; by default those that it has stages for, or there is no end.
        durations: How long actions take, and how much they earn by time.

    Raises:
        ModelError: If the policy is of other sizes, or, with a discount of 1, goes on for ever; or if the durations do
            not fit the model.
    """
    wrong = mismatch(policy, model)
    if wrong is not None:
        raise ModelError(wrong)
    count = len(model.state_space)
    model = model if durations is None else in_time(model, durations)

    def weights(*stage: int) -> Vector:
        """Return those of the policy; where time has discounted all, any action will do."""
        given = policy.weights(*stage)
        return given if durations is None else np.column_stack([given, np.full(len(given), 1 / len(given))])

    if policy.horizon is None:
        moves, rewards = _chain(model, weights())
        return _total(moves, None, rewards, model.discount, steps)[:count]
    values = np.zeros(len(model.state_space))
    for stage in reversed(range(policy.horizon if steps is None else min(steps, policy.horizon))):
        moves, rewards = _chain(model, weights(stage))
        values = rewards + model.discount * (moves @ values)
    return values[:count]


def _chain(model: MDP, weights: Vector) -> tuple[Any, Vector]:
    """Return the transitions and rewards of the Markov chain under some probabilities of actions, A x S."""
    return state_moves(model, weights), np.einsum("as,sa->s", weights, model.rewards)


def state_moves(model: MDP, weights: Vector) -> Any:
    """Return the transitions of the Markov chain under some probabilities of actions, A x S."""
    moves: Any = 0
    for action, weight in enumerate(weights):
        if weight.any():
            moves = moves + _scaled(model.transition_matrix(action), weight)
    return moves


def controller_values(model: POMDP, controller: FiniteStateController, *, steps: int | None = None) -> Vector:
    """Return the value of each node of a controller from each state: N x S.

    Where a node has no successor the plan ends, without further rewards. False negatives and events
    without an observation leave the node as it is and count for no decision.

    Args:
        model: The model.
        controller: The controller.
        steps: Decisions; by default there is no end but the plan's own.

    Raises:
        ModelError: If the controller is of other sizes, or, with a discount of 1, goes on for ever.
    """
    sizes = len(model.action_space), len(model.observation_space)
    if (controller.num_actions, controller.num_observations) != sizes:
        raise ModelError(
            f"the controller is for {controller.num_actions} actions and {controller.num_observations} observations, "
            f"but the model has {sizes[0]} and {sizes[1]}"
        )
    moves, stays = controller_moves(model, controller)
    rewards = model.rewards[:, list(controller.actions)].T.ravel()
    total = _total(moves, stays, rewards, model.discount, steps)
    return total.reshape(controller.num_nodes, len(model.state_space))


def controller_moves(
    model: POMDP, controller: FiniteStateController, *, ends: bool = False
) -> tuple[Matrix, Matrix | None]:
    """Return the transitions of the chain over pairs of a node and a state, N S x N S.

    Args:
        model: The model.
        controller: The controller, of the model's sizes.
        ends: Whether there is one more node for the end of the plan, in which a state stays as it is. By default
            the moves to the end are left out.

    Returns:
        The probabilities of steps that end in a decision, and of those that do not; None where all do.
    """
    size, nodes = len(model.state_space), controller.num_nodes
    moves, stays = _Pairs(size, nodes + ends), _Pairs(size, nodes + ends)
    waits = model.event_observations or model.false_negative is not None
    ended = nodes if ends else None
    for action in set(controller.actions):
        at = [node for node in range(nodes) if controller.actions[node] == action]
        left: Any = csr(model.transition_matrix(action))
        for observation in range(controller.num_observations):
            if observation == model.false_negative:
                continue
            joint = csr(model.joint_matrix(action, observation))
            left = left - joint
            for node in at:
                after = controller.successors[node][observation]
                moves.add(node, ended if after is None else after, joint)
        if waits:
            left.data[left.data < _EXACT] = 0
            left.eliminate_zeros()
            for node in at:
                stays.add(node, node, left)
    moves.add(nodes, ended, csr_identity(size))
    return moves.matrix(), stays.matrix() if waits else None


class _Pairs:
    """A matrix over pairs of a node and a state, from its blocks."""

    def __init__(self, size: int, nodes: int) -> None:
        self._size = size
        self._shape = (nodes * size, nodes * size)
        self._rows: list[Any] = [np.empty(0, dtype=np.intp)]
        self._columns: list[Any] = [np.empty(0, dtype=np.intp)]
        self._data: list[Any] = [np.empty(0)]

    def add(self, node: int, after: int | None, block: Matrix) -> None:
        """Add the transitions from one node to another."""
        if after is not None:
            entries = block.tocoo()
            self._rows.append(entries.row + node * self._size)
            self._columns.append(entries.col + after * self._size)
            self._data.append(entries.data)

    def matrix(self) -> Matrix:
        """Return the whole."""
        from scipy.sparse import coo_array  # noqa: PLC0415 - as long to import as all the rest

        parts = (np.concatenate(each) for each in (self._data, self._rows, self._columns))
        data, rows, columns = parts
        return csr(coo_array((data, (rows, columns)), shape=self._shape))


def _scaled(matrix: Matrix, weights: Vector) -> Matrix:
    """Return a matrix with each row times a weight."""
    if not is_compressed(matrix):
        return weights[:, None] * matrix
    rows = np.repeat(weights, np.diff(matrix.indptr))
    result = csr((matrix.data * rows, matrix.indices, matrix.indptr), matrix.shape)
    result.eliminate_zeros()
    return result


def _total(moves: Matrix, stays: Matrix | None, rewards: Vector, discount: float, steps: int | None) -> Vector:
    """Return the discounted total of a chain's rewards.

    Args:
        moves: The probabilities of steps that end in a decision.
        stays: Those of steps that do not.
        rewards: Of each state of the chain, in each step of time.
        discount: Of each step of time.
        steps: Decisions.
    """
    if steps is None:
        return _solved(moves if stays is None else csr(moves + stays), rewards, discount)
    values = rewards
    for _ in range(steps - 1):
        values = rewards + discount * (moves @ values)
        if stays is not None:
            values = _solved(stays, values, discount)
    return values


def _solved(moves: Matrix, rewards: Vector, discount: float) -> Vector:
    """Return x = r + g P x."""
    if discount == 1:
        endless = _endless(moves)
        if (rewards[endless] != 0).any():
            raise ModelError(
                "with a discount of 1 the policy goes on for ever, and earns without bound: give a discount or a "
                "number of steps"
            )
        if endless.any():
            values = np.zeros(len(rewards))
            going = np.flatnonzero(~endless)
            if len(going):
                values[going] = _solved(moves[np.ix_(going, going)], rewards[going], discount)
            return values
    if len(rewards) <= _DENSE:
        dense = moves.toarray() if is_compressed(moves) else moves
        return np.asarray(np.linalg.solve(np.eye(len(rewards)) - discount * dense, rewards))
    return _repeated(csr(moves), rewards, discount)


def _repeated(moves: Matrix, rewards: Vector, discount: float) -> Vector:
    """Return x = r + g P x for a large P."""
    from scipy.sparse.linalg import LinearOperator, bicgstab, splu  # noqa: PLC0415

    size = len(rewards)

    def close(values: Vector) -> bool:
        error = np.abs(rewards + discount * (moves @ values) - values).max() / (1 - discount)
        return bool(error <= _EXACT * max(1.0, np.abs(values).max()))

    if discount == 1:
        from scipy.sparse import eye_array  # noqa: PLC0415

        return np.asarray(splu((eye_array(size) - moves).tocsc()).solve(rewards))
    system = LinearOperator((size, size), matvec=lambda x: x - discount * (moves @ x), dtype=np.float64)
    values, _ = bicgstab(system, rewards, rtol=_EXACT * (1 - discount) / 10, maxiter=1_000)
    if not np.isfinite(values).all():
        values = rewards
    while not close(values):
        for _ in range(10):
            values = rewards + discount * (moves @ values)
    return np.asarray(values)


def _endless(moves: Matrix) -> Any:
    """Return a mask of the recurrent states of a chain."""
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    chain = csr(moves)
    count, labels = connected_components(chain, connection="strong")
    closed = np.ones(count, dtype=bool)
    rows = np.repeat(np.arange(chain.shape[0]), np.diff(chain.indptr))
    closed[labels[rows][labels[rows] != labels[chain.indices]]] = False
    closed[labels[np.asarray(chain.sum(axis=1)).ravel() < 1 - _EXACT]] = False
    return closed[labels]
