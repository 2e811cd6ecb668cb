"""Packing of two-slice networks into arrays and a header struct."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.models.factored.potential import Node, Potential, Role, Table, Tree
from mdm.models.factored.two_slice import TwoSliceNetwork

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.models import Space

__all__ = ["Network", "pack_network", "unpack_network"]


class _Table(msgspec.Struct, tag="table"):
    scope: list[tuple[Role, int]]
    values: str


class _Tree(msgspec.Struct, tag="tree"):
    node: tuple[Role, int]
    choice: list[int]
    branches: list[int]


class Network(msgspec.Struct):
    """A network's distinct potentials, branches before their trees, and the indices of those in each role."""

    potentials: list[_Table | _Tree]
    initial: list[int]
    transitions: list[int]
    observation: list[int]
    utilities: list[int]
    fully_observed: list[bool]
    event_observations: bool


def pack_network(network: TwoSliceNetwork, arrays: dict[str, Any]) -> Network:
    """Return a network as a struct, and add its tables to ``arrays``."""
    places: dict[int, int] = {}
    potentials: list[_Table | _Tree] = []

    def place(potential: Potential) -> int:
        key = id(potential)
        if key in places:
            return places[key]
        if isinstance(potential, Table):
            name = f"P{len(potentials)}"
            arrays[name] = potential.values
            packed: _Table | _Tree = _Table([(node.role, node.place) for node in potential.scope], name)
        else:
            branches = [place(branch) for branch in potential.branches]
            packed = _Tree((potential.node.role, potential.node.place), potential.choice.tolist(), branches)
        potentials.append(packed)
        places[key] = len(potentials) - 1
        return places[key]

    def each(of: Sequence[Potential]) -> list[int]:
        return [place(potential) for potential in of]

    return Network(
        potentials,
        initial=each(network.initial),
        transitions=each(network.transitions),
        observation=each(network.observation),
        utilities=each(network.utilities),
        fully_observed=list(network.fully_observed),
        event_observations=network.event_observations,
    )


def unpack_network(
    packed: Network, arrays: Mapping[str, Any], states: Space, actions: Space, observations: Space | None
) -> TwoSliceNetwork:
    """Return the network of a packed struct and its arrays.

    Raises:
        KeyError: If an array is missing.
        ModelError: If the parts are inconsistent.
    """
    made: list[Potential] = []
    for potential in packed.potentials:
        if isinstance(potential, _Table):
            values = arrays[potential.values]
            if values.dtype != np.float64 or not np.isfinite(values).all():
                raise ModelError(f"table {potential.values} holds values that are not finite floats")
            made.append(Table([Node(*node) for node in potential.scope], values))
        else:
            made.append(Tree(Node(*potential.node), potential.choice, _chosen(made, potential.branches)))
    return TwoSliceNetwork(
        states,
        actions,
        observations,
        initial=_chosen(made, packed.initial),
        transitions=_chosen(made, packed.transitions),
        observation=_chosen(made, packed.observation),
        utilities=_chosen(made, packed.utilities),
        fully_observed=packed.fully_observed,
        event_observations=packed.event_observations,
    )


def _chosen(made: list[Potential], places: list[int]) -> list[Potential]:
    if not all(0 <= place < len(made) for place in places):
        raise ModelError("a potential refers to one that is not listed before it")
    return [made[place] for place in places]
