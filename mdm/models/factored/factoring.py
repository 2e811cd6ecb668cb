"""Any model as a two-slice network: joint distributions factored by the chain rule.

P(x, y | z) = P(x | z) P(y | x, z): each factor depends on the conditions and on the factors before it. The tables are
as large as the joint distribution.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.factored.model import FactoredMDP, FactoredPOMDP
from mdm.models.factored.two_slice import Node, Role, Table, TwoSliceNetwork
from mdm.models.matrices import is_compressed
from mdm.models.pomdp import POMDP

if TYPE_CHECKING:
    from mdm.models.matrices import Vector
    from mdm.models.mdp import MDP
    from mdm.models.space import Space

__all__ = ["as_network"]

_LARGEST = 20_000_000


def as_network(model: MDP) -> TwoSliceNetwork:
    """Return a factored model's own network, or one by the chain rule.

    Raises:
        ModelError: If its tables would be too large.
    """
    if isinstance(model, FactoredMDP | FactoredPOMDP):
        return model.network
    states, actions = model.state_space, model.action_space
    sizes = {"state": len(states), "action": len(actions), "next_state": len(states)}
    if isinstance(model, POMDP):
        sizes["observation"] = len(model.observation_space)
        if not model.event_observations:
            del sizes["state"]
    total = max(math.prod(sizes.values()), len(states) ** 2 * len(actions))
    if total > _LARGEST:
        raise ModelError(
            f"the model has {total} entries, too many for the tables of a factored format (at most {_LARGEST}); "
            f"write an archive (.npz) instead"
        )
    transitions = np.stack([_dense(model.transition_matrix(a)) for a in range(len(actions))])
    before = [*_nodes("action", actions), *_nodes("state", states)]
    shape = (*actions.shape, *states.shape)
    observed: dict[str, Any] = {}
    if isinstance(model, POMDP):
        observed = {
            "observations": model.observation_space,
            "observation": _observation(model),
            "event_observations": model.event_observations,
        }
    return TwoSliceNetwork(
        states,
        actions,
        initial=_chain(model.initial_belief, "state", states, []),
        transitions=_chain(transitions.reshape(*shape, len(states)), "next_state", states, before),
        utilities=[_utility(model)],
        **observed,
    )


def _observation(model: POMDP) -> list[Table]:
    states, actions, observations = model.state_space, model.action_space, model.observation_space
    after = _nodes("next_state", states)
    if not model.event_observations:
        matrices = np.stack([_dense(model.observation_matrix(a)) for a in range(len(actions))])
        given = matrices.reshape(*actions.shape, *states.shape, len(observations))
        return _chain(given, "observation", observations, [*_nodes("action", actions), *after])
    events = np.stack(
        [
            np.stack([_dense(model.event_matrix(a, o)) for o in range(len(observations))], axis=-1)
            for a in range(len(actions))
        ]
    )
    given = events.reshape(*actions.shape, *states.shape, *states.shape, len(observations))
    before = [*_nodes("action", actions), *_nodes("state", states), *after]
    return _chain(given, "observation", observations, before)


def _utility(model: MDP) -> Table:
    states, actions = model.state_space, model.action_space
    scope = [*_nodes("action", actions), *_nodes("state", states)]
    shape = (*actions.shape, *states.shape)
    finer = None if model.outcome_rewards is None else model.outcome_rewards.array(_LARGEST)
    if finer is None:
        return Table(scope, model.rewards.T.reshape(shape))
    scope += _nodes("next_state", states)
    shape += states.shape
    if finer.ndim == 4 and isinstance(model, POMDP):
        scope += _nodes("observation", model.observation_space)
        shape += model.observation_space.shape
    return Table(scope, finer.reshape(shape))


def _chain(joint: Vector, role: Role, space: Space, given: list[Node]) -> list[Table]:
    """Return the distribution of each factor, given the factors before it.

    Args:
        joint: The joint distribution: an axis per variable of ``given``, then the joint symbols.
        role: The role of the factors.
        space: The joint symbols.
        given: The conditions.
    """
    values = joint.reshape(joint.shape[:-1] + space.shape)
    scope = list(given)
    tables = []
    for place in range(len(space.factors)):
        weights = values.sum(axis=tuple(range(len(scope) + 1, values.ndim)))  # of the factors up to this one
        if place:
            totals = weights.sum(axis=-1, keepdims=True)
            uniform = np.full(weights.shape, 1 / weights.shape[-1])  # for impossible conditions, any will do
            weights = np.divide(weights, totals, out=uniform, where=totals > 0)
        scope.append(Node(role, place))
        tables.append(Table(scope, weights))
    return tables


def _nodes(role: Role, space: Space) -> list[Node]:
    return [Node(role, place) for place in range(len(space.factors))]


def _dense(matrix: Any) -> Vector:
    dense: Vector = matrix.toarray() if is_compressed(matrix) else matrix
    return dense
