"""Blind policies: one action for ever, whatever is observed.

What they are worth is the plainest lower bound of a POMDP's value function, one vector per action (M. Hauskrecht,
*Incremental methods for computing bounds in partially observable Markov decision processes*, AAAI 1997). It is
approached from below, so that it holds wherever the sweeps end; each costs the entries of one action's T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.matrices import Matrix, Vector

__all__ = ["blind_values", "for_ever"]

_SWEEPS = 100_000
_ROUNDING = 1e-12


def blind_values(rewards: Vector, transitions: Sequence[Matrix], discount: float, close: float) -> Vector:
    """Return what each action is worth if it is done for ever, A x S: never too large, and a little too small.

    Args:
        rewards: A x S.
        transitions: T of each action, S x S.
        discount: Below 1.
        close: How much too small.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    result = np.empty_like(rewards)
    for action, each in enumerate(rewards):
        values = np.full(len(each), for_ever(each.min(), discount))
        for _ in range(_SWEEPS):
            better = each + discount * (transitions[action] @ values)
            change = np.abs(better - values).max()
            values = better
            if change * discount <= close * (1 - discount):
                break
        # What rounding may have added is taken off again.
        result[action] = values - _ROUNDING * np.abs(values).max()
    return result


def for_ever(reward: float, discount: float) -> float:
    """Return what a reward in every step is worth.

    Raises:
        ModelError: If it is too much for numbers.
    """
    with np.errstate(over="ignore"):
        value = float(np.float64(reward) / (1 - discount))
    if not np.abs(value) < np.finfo(np.float64).max / 1e3:
        raise ModelError(f"a reward of {reward:g} in every step is too much for numbers: scale the rewards down")
    return value
