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
    size, table = len(model.state_space), getattr(policy, "input", None) == "state"
    if table and not hasattr(policy, "weights"):
        return None
    controller: Any = policy.joined() if not table and model.pomdp is not None and hasattr(policy, "joined") else None
    if not table and controller is None:
        return None
    parts = (1 if policy.horizon is None else policy.horizon + 1) if table else controller.num_nodes + 1
    if parts * size > _SIZE:
        raise ModelError(
            f"the policy's chain has {parts} x {size} states, and at most {_SIZE:,} are verified: "
            f"verify a policy with fewer nodes or stages"
        )
    start, weights = np.zeros((parts, size)), np.zeros((parts, size, len(model.action_space) + 1))
    state = np.tile(np.arange(size), parts)
    if table:
        # Behind the last stage a state stays as it is.
        blocks: list[list[Any]] = [[None] * parts for _ in range(parts)]
        blocks[0][0], blocks[-1][-1] = csr((size, size)), eye_array(size, format="csr")
        weights[-1, :, -1] = policy.horizon is not None
        for stage in range(parts if policy.horizon is None else policy.horizon):
            weights[stage, :, :-1] = policy.weights(*([] if policy.horizon is None else [stage])).T
            blocks[stage][min(stage + 1, parts - 1)] = csr(state_moves(model, weights[stage, :, :-1].T))
        start[0] = model.initial_belief
        return Chain(csr(block_array(blocks)), start.ravel(), state, weights.reshape(len(state), -1))
    assert model.pomdp is not None
    moves, stays = controller_moves(model.pomdp, controller, ends=True)
    for first in np.flatnonzero(model.initial_belief).tolist():
        at = model.pomdp.belief_at_start(first) if model.observed else model.initial_belief
        begins = controller.start if controller.values is None else controller.start_node(at)
        start[begins, first] = model.initial_belief[first]
    weights[np.arange(parts), :, [*controller.actions, -1]] = 1
    whole = moves if stays is None else csr(moves + stays)
    return Chain(whole, start.ravel(), state, weights.reshape(len(state), -1))
