"""River swim: a small reward at hand, a large one against the current."""

from __future__ import annotations

import numpy as np

from mdm.errors import ModelError
from mdm.models import MDP
from mdm.problems.parameters import checked

__all__ = ["river_swim"]


@checked
def river_swim(
    length: int = 6, *, left_reward: float = 5.0, right_reward: float = 10_000.0, discount: float = 0.95
) -> MDP:
    """Return river swim: a small reward at the left end is easy to get, a large one at the right end hard.

    Swimming left always succeeds and pays at the left end. Swimming right, against the current, gets on with a
    probability of 0.3, and is driven back with one of 0.1 (0.7 at the right end); staying at the right end pays.

    As many states as the river is long, 2 actions. The swimmer begins in one of the two states beside the left end.

    Source: A. L. Strehl and M. L. Littman, *An analysis of model-based interval estimation for Markov decision
    processes*, Journal of Computer and System Sciences 74, 2008, section 5.

    Args:
        length: How many states there are; at least 3.
        left_reward: What swimming left at the left end pays.
        right_reward: What holding out at the right end pays.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than three states.
    """
    if length < 3:
        raise ModelError(f"a river needs at least three states, not {length}")
    place = np.arange(length)
    left, right = np.zeros((2, length, length))
    left[place, np.maximum(place - 1, 0)] = 1
    right[place[:-1], place[1:]] = 0.3
    right[place[1:], place[:-1]] = 0.1
    right[place, place] = 0.6
    right[0, 0] = 0.7
    right[-1, -2:] = 0.7, 0.3
    rewards = np.zeros((2, length, length))
    rewards[0, 0, 0] = left_reward
    rewards[1, -1, -1] = right_reward
    return MDP(
        [left, right],
        rewards,
        discount=discount,
        states=[f"place-{number}" for number in place],
        actions=["left", "right"],
        initial_belief=np.isin(place, [1, 2]) / 2,
    )
