"""Random policies of every kind, and what it means that two are the same."""

from __future__ import annotations

import numpy as np

from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StochasticPolicy,
)


def floats(random, *shape):
    """Return numbers of all sizes, with no digits to spare."""
    return random.normal(size=shape) * 10.0 ** random.integers(-300, 300, size=shape)


def deterministic(random, count):
    return DeterministicPolicy(random.integers(4, size=count).tolist(), 4)


def stochastic(random, count):
    return StochasticPolicy(random.dirichlet(np.ones(3), size=count).T)


def q_values(random, count):
    return QTable(floats(random, count, 3) + 2)


def alpha(random, count):
    return AlphaVectors(floats(random, count, 3), random.integers(4, size=count).tolist())


def mixed(random, count):
    observed = [1, *random.integers(2, size=count).tolist()]
    actions = random.integers(4, size=len(observed)).tolist()
    return MixedAlphaVectors(floats(random, len(observed), 3), actions, observed)


def masked(random, count):
    states = [random.permutation(4)[: random.integers(1, 4)].tolist() for _ in range(count)]
    vectors = [dict(zip(own, floats(random, len(own)).tolist(), strict=True)) for own in states]
    return MaskedAlphaVectors(vectors, random.integers(4, size=count).tolist())


def controller(random, count):
    rows = random.integers(-1, count, size=(count, 2)).tolist()
    successors = [[None if node == -1 else node for node in row] for row in rows]
    values = floats(random, count, 3) if random.integers(2) else None
    return FiniteStateController(random.integers(4, size=count).tolist(), successors, values=values)


def joint(random, count):
    return JointController(controller(random, count) for _ in range(random.integers(1, 4)))


KINDS = [deterministic, stochastic, q_values, alpha, mixed, masked, controller, joint]


def assert_same(first, second):
    """Compare two policies, number by number."""
    kind, sizes, arrays = first.kind, *first.packed()
    other_kind, other_sizes, other_arrays = second.kind, *second.packed()
    assert (kind, sizes) == (other_kind, other_sizes)
    assert arrays.keys() == other_arrays.keys()
    for name, array in arrays.items():
        assert array.dtype == other_arrays[name].dtype
        np.testing.assert_array_equal(array, other_arrays[name])
