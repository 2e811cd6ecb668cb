"""The values of alpha vectors at a belief, for numba: the rows of a support are read in place, not copied."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.compilation import compiled

if TYPE_CHECKING:
    from mdm.models.matrices import Vector


@compiled
def at_belief(by_state: Vector, belief: Vector) -> Vector:
    """Return the values of N vectors, given as S x N, at a belief of S numbers."""
    values = np.zeros(by_state.shape[1])
    for state in range(belief.size):
        weight = belief[state]
        if weight != 0.0:
            row = by_state[state]
            for vector in range(values.size):
                values[vector] += weight * row[vector]
    return values


@compiled
def at_support(by_state: Vector, states: Any, weights: Vector) -> Vector:
    """Return the values of N vectors at a belief, given by its support."""
    if states.size != weights.size:
        raise IndexError("each state has one weight")
    for index in range(states.size):
        if not 0 <= states[index] < by_state.shape[0]:
            raise IndexError("there is no such state")
    values = np.zeros(by_state.shape[1])
    for index in range(states.size):
        weight = weights[index]
        row = by_state[states[index]]
        for vector in range(values.size):
            values[vector] += weight * row[vector]
    return values
