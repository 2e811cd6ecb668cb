"""Machine maintenance: when to inspect, repair or replace a machine whose parts wear out."""

from __future__ import annotations

import numpy as np

from mdm.errors import ModelError
from mdm.models import Factor, FactoredPOMDP, Node, Potential, Space, Table, Tree, TwoSliceNetwork
from mdm.problems.parameters import checked

_CONDITIONS = ("broken", "poor", "fair", "good")
_ACTIONS = ("manufacture", "inspect", "repair", "replace")
_WEAR, _REPAIRED = 0.03, 0.8
_FLAWLESS = (0.0, 0.75, 0.95, 1.0)
"""By a component's condition, with which probability it does not spoil a product."""
_LOOKS_GOOD = (0.02, 0.05, 0.8, 0.97)
"""The probability that an inspected component looks good, by its condition."""


@checked
def machine_maintenance(components: int = 4, *, discount: float = 0.999) -> FactoredPOMDP:
    """Return the machine maintenance problem: components wear out unseen, and spoil what the machine makes.

    Each component is good, fair, poor or broken. Manufacturing may wear each of them by one condition; it pays 1 for a
    good product, and shows whether it is one. Inspecting, which costs 1, shows with errors which components are good.
    Repairing, for 3, may bring each component that is fair or poor one condition further. Replacing, for 15, makes all
    of them good. The machine begins as new.

    4^components states, 4 actions, 2^components observations: 256, 4 and 16 as in A. R. Cassandra's file machine. A
    good product shows as all components good, a spoilt one, a repair and a replacement as all bad.

    Source: A. R. Cassandra, *Exact and approximate algorithms for partially observable Markov decision processes*, PhD
    thesis, Brown University, 1998.

    Args:
        components: How many components the machine has.
        discount: In (0, 1].

    Raises:
        ModelError: If there is no component.
    """
    if components < 1:
        raise ModelError(f"a machine needs at least one component, not {components}")
    action = Node("action", 0)
    part = [Node("state", number) for number in range(components)]
    part_then = [Node("next_state", number) for number in range(components)]
    seen = [Node("observation", number) for number in range(components)]
    identity = np.eye(4)
    worn = np.diag([1.0, *[1 - _WEAR] * 3]) + np.diag([_WEAR] * 3, -1)
    repaired = np.diag([1.0, 1 - _REPAIRED, 1 - _REPAIRED, 1.0]) + np.diag([0, _REPAIRED, _REPAIRED], 1)
    replaced = np.tile(identity[-1], (4, 1))
    spoilt = Table([seen[0]], [1.0, 0.0])
    flawless = np.prod(np.meshgrid(*[_FLAWLESS] * components, indexing="ij"), axis=0)  # an axis per component
    product = Table([*part_then, seen[0]], np.stack([1 - flawless, flawless], axis=-1))
    looks = np.stack([1 - np.array(_LOOKS_GOOD), _LOOKS_GOOD], axis=1)
    first: Potential = Tree(action, [0, 1, 2, 2], [product, Table([part_then[0], seen[0]], looks), spoilt])
    # Without an inspection all components look as the first.
    others: list[Potential] = [
        Tree(
            action,
            [0, 1, 0, 0],
            [Table([seen[0], seen[number]], np.eye(2)), Table([part_then[number], seen[number]], looks)],
        )
        for number in range(1, components)
    ]
    network = TwoSliceNetwork(
        Space([Factor(f"component-{number}", _CONDITIONS) for number in range(components)]),
        Space.single("operator", _ACTIONS),
        Space([Factor(f"sign-{number}", ["bad", "good"]) for number in range(components)]),
        initial=[Table([node], identity[-1]) for node in part],
        transitions=[
            Table([action, node, then], [worn, identity, repaired, replaced])
            for node, then in zip(part, part_then, strict=True)
        ],
        observation=[first, *others],
        utilities=[
            Table([action], [0.0, -1.0, -3.0, -15.0]),
            Tree(action, [0, 1, 1, 1], [Table([seen[0]], [0.0, 1.0]), Table([seen[0]], [0.0, 0.0])]),
        ],
    )
    return FactoredPOMDP(network, discount=discount)
