"""The bounds that SARSOP begins with: blind policies from below, the fast informed bound from above.

Below, one action for ever (M. Hauskrecht, *Incremental methods for computing bounds in partially observable Markov
decision processes*, AAAI 1997); above, the fast informed bound (M. Hauskrecht, *Value-function approximations for
partially observable Markov decision processes*, JAIR 13, 2000, section 4.5). Both are approached from the safe side,
so that they hold wherever the sweeps stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.compilation import compiled
from mdm.models.compressed import csr
from mdm.policies import blind_policy

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.sarsop.layout import Layout

__all__ = ["blind_values", "informed_values"]

_SWEEPS = 1000


def blind_values(layout: Layout) -> Vector:
    """Return what doing one action for ever is worth at least: A x S."""
    close = 1e-6 * float(np.ptp(layout.rewards)) / (1 - layout.discount)
    return blind_policy.blind_values(layout.rewards, _transitions(layout), layout.discount, close)


def informed_values(layout: Layout, precision: float, is_late: Callable[[], bool] = lambda: False) -> Vector:
    """Return the fast informed bound: A x S, whose greatest product with a belief is never less than its value.

    Args:
        layout: The model.
        precision: Sweeps stop when they change no value by more than this share of the values' range.
        is_late: Whether it is time to stop in any case.
    """
    matrices = _transitions(layout)
    num_actions, num_states = layout.rewards.shape
    values = np.full(num_states, blind_policy.for_ever(layout.rewards.max(), layout.discount))
    worth = np.empty((num_actions, num_states))
    for _ in range(_SWEEPS):
        for action in range(num_actions):
            worth[action] = layout.rewards[action] + layout.discount * (matrices[action] @ values)
        better = worth.max(axis=0)
        change = np.abs(better - values).max()
        values = better
        if change <= 0.1 * precision * max(1e-12, np.ptp(values)) or is_late():
            break
    for action in range(num_actions):
        worth[action] = layout.rewards[action] + layout.discount * (matrices[action] @ values)
    gathered = np.zeros((int(layout.symbols.max()) + 1, num_actions))
    fresh = np.ones(len(gathered), dtype=np.bool_)
    found = np.zeros(len(gathered), dtype=np.int32)
    for _ in range(_SWEEPS):
        change = _informed_sweep(layout, worth, gathered, fresh, found)
        if change <= precision * max(1e-12, np.ptp(worth)) or is_late():
            break
    return np.asarray(worth + 1e-12 * np.abs(worth).max())


def _transitions(layout: Layout) -> list[Matrix]:
    num_actions, num_states = layout.rewards.shape
    matrices = []
    for action in range(num_actions):
        starts = layout.rows[action * num_states : (action + 1) * num_states + 1]
        part = slice(starts[0], starts[-1])
        matrices.append(
            csr((layout.chances[part], layout.next_states[part], starts - starts[0]), (num_states, num_states))
        )
    return matrices


@compiled
def _informed_sweep(
    layout: Layout, worth: np.ndarray, gathered: np.ndarray, fresh: np.ndarray, found: np.ndarray
) -> float:
    """Improve all values in place; return the greatest change."""
    num_actions, num_states = layout.rewards.shape
    greatest = 0.0
    for action in range(num_actions):
        for state in range(num_states):
            row = action * num_states + state
            count = 0
            for j in range(layout.rows[row], layout.rows[row + 1]):
                after = layout.next_states[j]
                seen = action * num_states + after
                for i in range(layout.seen_rows[seen], layout.seen_rows[seen + 1]):
                    symbol = layout.symbols[i]
                    if fresh[symbol]:
                        fresh[symbol] = False
                        found[count] = symbol
                        count += 1
                        for other in range(num_actions):
                            gathered[symbol, other] = 0.0
                    chance = layout.chances[j] * layout.likelihoods[i]
                    for other in range(num_actions):
                        gathered[symbol, other] += chance * worth[other, after]
            total = 0.0
            for i in range(count):
                best = gathered[found[i], 0]
                for other in range(1, num_actions):
                    best = max(best, gathered[found[i], other])
                total += best
                fresh[found[i]] = True
            value = layout.rewards[action, state] + layout.discount * total
            greatest = max(greatest, worth[action, state] - value)
            worth[action, state] = min(worth[action, state], value)
    return greatest
