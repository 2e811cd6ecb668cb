"""The size of a network's matrices, before they are made.

Transitions and observations are counted on a sample of states and actions, by random walks: each variable of the next
slice takes one of its possible values, and the product of their numbers is on average how many joint values are
possible (D. E. Knuth, *Estimating the efficiency of backtrack programs*, Mathematics of Computation 29, 1975). The
walks are the same in every process. Cost: some numpy calls per variable, whatever the size of the model.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.models.factored.two_slice import Node
from mdm.models.matrices import MatrixSize, is_large_and_sparse

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.factored.two_slice import Potential, Role, TwoSliceNetwork

__all__ = ["matrix_size"]

_WALKS = 4096
_NUMBER = 8
"""Bytes of a number."""


def matrix_size(network: TwoSliceNetwork, *, sparse: bool | None = None) -> MatrixSize:
    """Return how many bytes the matrices of a network would take.

    Args:
        network: The network.
        sparse: Force CSR or dense matrices; None chooses as models do.
    """
    states, actions = len(network.states), len(network.actions)
    observations = 0 if network.observations is None else len(network.observations)
    after, seen = _entries(network)
    matrices = _distinct(network, network.transitions)
    compressed = is_large_and_sparse(actions, states, states, after * actions) if sparse is None else sparse
    transitions = matrices * _bytes(states, states, after, compressed=compressed)
    if network.event_observations:
        told = actions * (
            _bytes(round(after), observations, after * seen, compressed=True)
            if compressed
            else states * states * observations * _NUMBER
        )
    elif observations:
        likely = is_large_and_sparse(actions, states, observations, seen * states * actions)
        narrow = likely if sparse is None else sparse
        told = _distinct(network, network.observation) * _bytes(states, observations, seen * states, compressed=narrow)
    else:
        told = 0
    told_entries = seen * (after if network.event_observations else states)
    return MatrixSize(transitions, told, states * actions * _NUMBER, matrices, round(after), round(told_entries))


def _entries(network: TwoSliceNetwork) -> tuple[float, float]:
    """Return how many entries T has for an action, and how many observations are possible after a transition."""
    random = np.random.Generator(np.random.PCG64(0))
    states, actions = len(network.states), len(network.actions)
    if states * actions <= _WALKS:
        joint = np.resize(np.arange(states * actions), _WALKS // (states * actions) * states * actions)
        before, taken = np.divmod(joint, actions)
    else:
        before, taken = random.integers(states, size=_WALKS), random.integers(actions, size=_WALKS)
    digits = _digits("state", before, network.states.shape) | _digits("action", taken, network.actions.shape)
    branches = _walk(network, "next_state", digits, random)
    if not network.event_observations:  # O has a row for each state, whether it is reached or not
        digits |= _digits("next_state", before, network.states.shape)
    told = _walk(network, "observation", digits, random)
    # Of events each entry of T has a row: a walk stands for as many as it has branches.
    weights = branches if network.event_observations else np.ones(len(branches))
    return float(branches.mean() * states), float(told @ weights / weights.sum())


def _walk(
    network: TwoSliceNetwork, role: Role, digits: dict[Node, npt.NDArray[np.intp]], random: np.random.Generator
) -> npt.NDArray[np.float64]:
    """Draw possible values of a role's variables into the digits; return the product of their numbers, of each walk."""
    count = len(next(iter(digits.values())))
    product = np.ones(count)
    for place in network.orders[role]:
        child, potential = Node(role, place), network.potentials(role)[place]
        given = {node: digits[node] for node in potential.scope if node != child}
        possible = potential.rows(given, count, child, len(network.factor(child))) > 0
        number = possible.sum(axis=1)
        product *= number
        drawn = (random.random(count) * number).astype(np.intp)
        digits[child] = (possible.cumsum(axis=1) > drawn[:, None]).argmax(axis=1)
    return product


def _distinct(network: TwoSliceNetwork, potentials: Sequence[Potential]) -> int:
    """Return how many different matrices there are: actions of equal effect share one."""
    used = {node for potential in potentials for node in potential.scope if node.role == "action"}
    return math.prod(len(network.factor(node)) for node in used)


def _bytes(rows: int, columns: int, entries: float, *, compressed: bool) -> int:
    """Return the bytes of a matrix."""
    if not compressed:
        return rows * columns * _NUMBER
    index = 4 if max(entries, columns, rows) <= np.iinfo(np.int32).max else 8
    return round(entries) * (_NUMBER + index) + (rows + 1) * index


def _digits(role: Role, joint: npt.NDArray[np.intp], shape: tuple[int, ...]) -> dict[Node, npt.NDArray[np.intp]]:
    return {Node(role, index): values for index, values in enumerate(np.unravel_index(joint, shape))}
