"""Links between variables of one role, which a chain rule over factors makes and some programs do not read.

Variables that are independent given their other parents need none: P(o, p | x) = P(o | x) P(p | x). Those that are not
can be joined into one. The tables are as large as the joint distribution.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.factored.two_slice import Node, Potential, Role, Table, TwoSliceNetwork, tabulated
from mdm.models.space import Factor, Space

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.matrices import Vector

__all__ = ["joined", "unlinked"]

_SAME = 1e-13
_LARGEST = 20_000_000
_PARTS: dict[Role, str] = {"state": "initial", "next_state": "transitions", "observation": "observation"}


def unlinked(network: TwoSliceNetwork, role: Role) -> TwoSliceNetwork | None:
    """Return the same network without links between variables of a role; None if these do depend on each other.

    Args:
        network: The network.
        role: ``observation``, ``next_state``, or ``state`` for the initial distribution.

    Raises:
        ModelError: If the tables would be too large.
    """
    if not _are_linked(network, role):
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


def _are_linked(network: TwoSliceNetwork, role: Role) -> bool:
    places = range(len(network.potentials(role)))
    return any(parent.role == role for place in places for parent in network.parents(Node(role, place)))


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
