"""The load/unload problem: a cart that does not see what it carries."""

from __future__ import annotations

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP
from mdm.problems.parameters import checked

__all__ = ["load_unload"]


@checked
def load_unload(positions: int = 8, *, discount: float = 0.95) -> POMDP:
    """Return the load/unload problem: a cart that goes to and fro on a track, and sees only its two ends.

    At the right end the cart is loaded, at the left end it is unloaded, which pays 1. It does not see whether it is
    loaded, nor where between the ends it is. It begins at the left end, unloaded.

    2 x positions - 2 states: 14 in the paper. 2 actions, 3 observations. The best policy goes from end to end; with
    n = 2 x positions - 2 it is worth discount^(n - 1) / (1 - discount^n), which is 1.0020 by default.

    Source: N. Meuleau, K.-E. Kim, L. P. Kaelbling and A. R. Cassandra, *Solving POMDPs by searching the space of finite
    policies*, Uncertainty in Artificial Intelligence, 1999, section 5.

    Args:
        positions: How many places the track has, the ends included; at least 2.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than two positions.
    """
    if positions < 2:
        raise ModelError(f"the track needs at least its two ends, not {positions} positions")
    last = positions - 1
    # Empty at 0 .. last - 1, then loaded at 1 .. last: at the ends the cart is unloaded or loaded at once.
    place = np.r_[0:last, 1 : last + 1]
    loaded = np.arange(2 * last) >= last
    transitions = np.zeros((2, 2 * last, 2 * last))
    rewards = np.zeros((2 * last, 2))
    for action, step in enumerate((-1, 1)):
        there = np.clip(place + step, 0, last)
        full = (there == last) | (loaded & (there > 0))
        transitions[action, np.arange(2 * last), np.where(full, there + last - 1, there)] = 1
        rewards[:, action] = loaded & (there == 0)
    seen = np.eye(3)[np.where(place == 0, 0, np.where(place == last, 2, 1))]
    return POMDP(
        transitions,
        [seen, seen],
        rewards,
        discount=discount,
        states=[f"{'loaded' if full else 'empty'}-{at}" for at, full in zip(place, loaded, strict=True)],
        actions=["left", "right"],
        observation_names=["unload-end", "between", "load-end"],
        initial_belief=np.eye(2 * last)[0],
    )
