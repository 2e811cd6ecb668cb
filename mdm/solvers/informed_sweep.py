"""A sweep of the fast informed bound, compiled; see `mdm.solvers.bounds`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.compilation import compiled

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.dynamics import Rows
    from mdm.models.matrices import Vector

__all__ = ["Scratch", "informed_sweep", "scratch"]


class Scratch(NamedTuple):
    """Room for one state and action; what is possible after it stands first in ``found``, with its sums.

    Attributes:
        place: The place of each observation in ``found``; -1 all over between uses.
        found: Observations.
        sums: For each of these and each next action the sum over s' of P(s', o | s, a) alpha(s').
    """

    place: npt.NDArray[np.int64]
    found: npt.NDArray[np.int64]
    sums: npt.NDArray[np.float64]


def scratch(num_observations: int, num_actions: int) -> Scratch:
    """Return room for a model of these sizes, where something may be left to no observation."""
    count = num_observations + 1
    return Scratch(np.full(count, -1), np.zeros(count, dtype=np.int64), np.zeros((count, num_actions)))


@compiled
def informed_sweep(
    transitions: Rows,
    observations: Rows,
    by_transition: bool,
    rewards: Vector,
    discount: float,
    table: Vector,
    room: Scratch,
) -> float:
    """Lower upper bounds, S x A, in place, each by the newest of the others; return by how much at most."""
    size, num_actions = table.shape
    greatest = 0.0
    for action in range(num_actions):
        first = transitions.first[action]
        shift = observations.first[action] - np.int64(transitions.starts[first])
        for state in range(size):
            count = 0
            for entry in range(transitions.starts[first + state], transitions.starts[first + state + 1]):
                after, chance = transitions.columns[entry], transitions.values[entry]
                seen = shift + np.int64(entry) if by_transition else observations.first[action] + np.int64(after)
                for at in range(observations.starts[seen], observations.starts[seen + 1]):
                    observation = observations.columns[at]
                    place = room.place[observation]
                    if place < 0:
                        place = count
                        room.place[observation], room.found[place] = place, observation
                        room.sums[place] = 0.0
                        count += 1
                    weight = chance * observations.values[at]
                    for other in range(num_actions):
                        room.sums[place, other] += weight * table[after, other]
            total = 0.0
            for place in range(count):
                total += room.sums[place].max()
                room.place[room.found[place]] = -1
            value = rewards[state, action] + discount * total
            if value < table[state, action]:
                greatest = max(greatest, table[state, action] - value)
                table[state, action] = value
    return greatest
