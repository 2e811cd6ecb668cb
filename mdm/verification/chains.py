"""The Markov chain of a policy in its model: over states, over stages and states, or over nodes and states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse import block_array, eye_array

from mdm.errors import ModelError
from mdm.models.matrices import csr
from mdm.solvers.evaluation import controller_moves, state_moves
from mdm.verification.choices import Choices

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.specification import Mask, Specification

    Indices = npt.NDArray[np.integer]

_SIZE = 2_000_000


class Chain(NamedTuple):
    """A policy's Markov chain, of N states, each of which stands for a state of the model.

    Args:
        moves: Its probabilities of going on, N x N.
        start: Its initial distribution.
        state: Of each of its states the model's.
        weights: The probability of each action there, N x (A + 1); the last is that the plan has ended.
    """

    moves: Matrix
    start: Vector
    state: Indices
    weights: Vector

    def chances(self, mask: Mask) -> Vector:
        """Return the probability that a formula holds in each state, by the actions there."""
        return np.asarray(np.einsum("na,na->n", self.weights, mask[self.state]))

    def before(self, asked: Specification) -> Choices:
        """Return the same before X or Y holds."""
        return Choices.of_chain(self.moves, self.chances(asked.reached), self.chances(asked.miss))


def chain_of_policy(model: MDP, policy: Any) -> Chain | None:
    """Return the chain of a policy over states, or of finite-state controllers; None for policies of other kinds.

    Raises:
        ModelError: If it has too many states.
    """
    size = len(model.state_space)
    if getattr(policy, "input", None) == "state":
        if not hasattr(policy, "weights"):
            return None
        return _of_table(model, policy) if policy.horizon is None else _of_stages(model, policy)
    if model.pomdp is None or not hasattr(policy, "joined"):
        return None
    controller = policy.joined()
    if controller is None:
        return None
    _check(controller.num_nodes + 1, size)
    moves, stays = controller_moves(model.pomdp, controller, ends=True)
    ended = controller.num_nodes
    start = np.zeros((ended + 1, size))
    for state in np.flatnonzero(model.initial_belief).tolist():
        at = model.pomdp.belief_at_start(state) if model.observed else model.initial_belief
        begins = controller.start if controller.values is None else controller.start_node(at)
        start[begins, state] = model.initial_belief[state]
    weights = np.zeros((ended + 1, len(model.action_space) + 1))
    weights[np.arange(ended + 1), [*controller.actions, -1]] = 1
    whole = moves if stays is None else csr(moves + stays)
    states = np.tile(np.arange(size), ended + 1)
    return Chain(whole, start.ravel(), states, np.repeat(weights, size, axis=0))


def _of_table(model: MDP, policy: Any) -> Chain:
    weights = np.append(policy.weights().T, np.zeros((len(model.state_space), 1)), axis=1)
    return Chain(csr(state_moves(model, weights[:, :-1].T)), model.initial_belief, np.arange(len(weights)), weights)


def _of_stages(model: MDP, policy: Any) -> Chain:
    """Return the chain over stages and states; behind the last stage a state stays as it is."""
    size, stages = len(model.state_space), policy.horizon
    _check(stages + 1, size)
    weights = np.zeros((stages + 1, size, len(model.action_space) + 1))
    blocks: list[list[Any]] = [[None] * (stages + 1) for _ in range(stages + 1)]
    for stage in range(stages):
        weights[stage, :, :-1] = policy.weights(stage).T
        blocks[stage][stage + 1] = csr(state_moves(model, weights[stage, :, :-1].T))
    weights[stages, :, -1] = 1
    blocks[stages][stages] = eye_array(size, format="csr")
    blocks[0][0] = csr((size, size))
    start = np.zeros((stages + 1, size))
    start[0] = model.initial_belief
    state = np.tile(np.arange(size), stages + 1)
    return Chain(csr(block_array(blocks)), start.ravel(), state, weights.reshape(len(state), -1))


def _check(parts: int, size: int) -> None:
    if parts * size > _SIZE:
        raise ModelError(
            f"the policy's chain has {parts} x {size} states, and at most {_SIZE:,} are verified: "
            f"verify a policy with fewer nodes or stages"
        )
