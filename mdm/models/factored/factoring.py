"""Any model as a two-slice network: joint distributions factored by the chain rule.

P(x, y | z) = P(x | z) P(y | x, z): each factor depends on the conditions and on the factors before it. The tables are
as large as the joint distribution.

That links variables of one role, which some programs do not read. Variables that are independent given their other
parents need no link: P(o, p | x) = P(o | x) P(p | x). Those that are not can be joined into one.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.factored.two_slice import Node, Potential, Role, Table, TwoSliceNetwork, tabulated
from mdm.models.matrices import is_compressed
from mdm.models.space import Factor, Space

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.matrices import Vector
    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP

_LARGEST = 20_000_000
_SAME = 1e-13
_PARTS: dict[Role, str] = {"state": "initial", "next_state": "transitions", "observation": "observation"}


def as_network(model: MDP) -> TwoSliceNetwork:
    """Return a factored model's own network, or one by the chain rule.

    Raises:
        ModelError: If its tables would be too large.
    """
    if model.network is not None:
        return model.network
    states, actions = model.state_space, model.action_space
    sizes = {"state": len(states), "action": len(actions), "next_state": len(states)}
    if model.observation_space is not None:
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
    if model.pomdp is not None:
        observed = {
            "observations": model.observation_space,
            "observation": _observation(model.pomdp),
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
    if finer.ndim == 4 and model.observation_space is not None:
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


def unlinked(network: TwoSliceNetwork, role: Role) -> TwoSliceNetwork | None:
    """Return the same network without links between variables of a role; None if these do depend on each other.

    Args:
        network: The network.
        role: ``observation``, ``next_state``, or ``state`` for the initial distribution.

    Raises:
        ModelError: If the tables would be too large.
    """
    places = range(len(network.potentials(role)))
    if not any(parent.role == role for place in places for parent in network.parents(Node(role, place))):
        return network
    given, joint = _joint(network, role)
    own = range(given, joint.ndim)
    mass = joint.sum(axis=tuple(own), keepdims=True)  # less than 1 where events may go unseen
    marginals = [joint.sum(axis=tuple(axis for axis in own if axis != kept), keepdims=True) for kept in own]
    # Given what never occurs, any distribution will do.
    shares = [np.divide(each, mass, out=np.full_like(each, 1 / each.size), where=mass > 0) for each in marginals]
    product = mass * math.prod(shares[1:], start=shares[0])
    if not np.allclose(product, joint, rtol=0, atol=_SAME):
        return None
    parents = _parents(network, role)
    tables = [
        Table([*parents, Node(role, place)], each.reshape(*joint.shape[:given], -1))
        for place, each in enumerate([marginals[0], *shares[1:]])
    ]
    return _with(network, {_PARTS[role]: tables})


def joined(network: TwoSliceNetwork, space: Literal["states", "observations"]) -> TwoSliceNetwork:
    """Return the same network with all state factors, or all observations, as one: the first most significant.

    Raises:
        ModelError: If the tables would be too large.
    """
    roles: tuple[Role, ...] = ("state", "next_state") if space == "states" else ("observation",)
    changed: dict[str, Any] = {
        part: [_over_joint(network, roles, each) for each in getattr(network, part)]
        for part in ("initial", "transitions", "observation", "utilities")
    }
    for role in roles:
        given, joint = _joint(network, role)
        own = [Node(role, place) for place in range(joint.ndim - given)]
        table = Table([*_parents(network, role), *own], joint)
        changed[_PARTS[role]] = [_over_joint(network, roles, table)]
    if space == "states":
        changed["fully_observed"] = [all(network.fully_observed)]
    changed[space] = _joint_space(getattr(network, space))
    return _with(network, changed)


def _joint_space(space: Space) -> Space:
    names = ["_".join(parts) for parts in itertools.product(*(factor.names for factor in space.factors))]
    if len(set(names)) < len(names):
        names = [str(index) for index in range(len(names))]
    return Space([Factor("_".join(factor.name for factor in space.factors), names)])


def _with(network: TwoSliceNetwork, changed: dict[str, Any]) -> TwoSliceNetwork:
    parts = {
        "states": network.states,
        "observations": network.observations,
        "initial": network.initial,
        "transitions": network.transitions,
        "observation": network.observation,
        "utilities": network.utilities,
        "fully_observed": network.fully_observed,
        "event_observations": network.event_observations,
    }
    return TwoSliceNetwork(actions=network.actions, **(parts | changed))


def _parents(network: TwoSliceNetwork, role: Role) -> list[Node]:
    """Return all variables of other roles on which those of a role depend."""
    nodes = (node for potential in network.potentials(role) for node in potential.scope if node.role != role)
    return list(dict.fromkeys(nodes))


def _joint(network: TwoSliceNetwork, role: Role) -> tuple[int, Vector]:
    """Return the number of parents, and a role's joint distribution: an axis per parent, then per variable."""
    parents, potentials = _parents(network, role), network.potentials(role)
    axes = parents + [Node(role, place) for place in range(len(potentials))]
    shape = _shape(network, axes)
    joint = np.ones(())
    for potential in potentials:
        joint = joint * _spread(network, potential, axes)
    return len(parents), np.broadcast_to(joint, shape)


def _over_joint(network: TwoSliceNetwork, roles: tuple[Role, ...], potential: Potential) -> Potential:
    """Return a potential over the joint variables of some roles, in place of single ones."""
    present = [role for role in roles if any(node.role == role for node in potential.scope)]
    if not present:
        return potential
    kept = [node for node in potential.scope if node.role not in present]
    every = [[Node(role, place) for place in range(len(network.factors(role)))] for role in present]
    axes = [*kept, *itertools.chain(*every)]
    values = np.broadcast_to(_spread(network, potential, axes), _shape(network, axes))
    sizes = [math.prod(_shape(network, nodes)) for nodes in every]
    return Table([*kept, *(Node(role, 0) for role in present)], values.reshape(*_shape(network, kept), *sizes))


def _spread(network: TwoSliceNetwork, potential: Potential, axes: Sequence[Node]) -> Vector:
    """Return a potential with the given axes, of length 1 where it does not depend on one."""
    table = tabulated(potential)
    own = [node for node in axes if node in table.scope]
    values = table.values.transpose([table.scope.index(node) for node in own])
    lengths = zip(axes, _shape(network, axes), strict=True)
    return values.reshape([length if node in own else 1 for node, length in lengths])


def _shape(network: TwoSliceNetwork, axes: Sequence[Node]) -> list[int]:
    shape = [len(network.factor(node)) for node in axes]
    if math.prod(shape) > _LARGEST:
        raise ModelError(
            f"variables depend on each other, and their joint table has {math.prod(shape)} entries (at most "
            f"{_LARGEST}): write an archive (.npz) instead"
        )
    return shape
