"""Recycling robots: two robots that look for cans and have to mind their batteries."""

from __future__ import annotations

from itertools import product

import numpy as np

from mdm.models import POMDP, Factor, Space
from mdm.problems.parameters import agents, checked

__all__ = ["recycling_robots"]

_RECHARGE, _LITTLE, _BIG = range(3)
_HIGH, _LOW = range(2)


@checked
def recycling_robots(*, discount: float = 0.9) -> POMDP:
    """Return the problem of two robots that search for cans until their batteries are low.

    A robot waits and recharges, searches for little cans, worth 2, or goes for the big one, worth 5, which takes both.
    Searching drains the battery: from high to low, or from low to empty; a robot that has run empty is carried to its
    charger at a cost of 10, and none of the two earns anything. Each robot sees the level of its own battery.

    4 states, 3 x 3 actions, 2 x 2 observations. Optimal values of decentralised plans without discount: 7 for 2
    decisions, 10.66013 for 3, 13.38 for 4, 16.486 for 5.

    Source: C. Amato, D. S. Bernstein and S. Zilberstein, *Optimizing memory-bounded controllers for decentralized
    POMDPs*, UAI 2007, after R. S. Sutton and A. G. Barto, *Reinforcement learning: an introduction*, 1998, example 3.3.
    Values: F. A. Oliehoek, M. T. J. Spaan, C. Amato and S. Whiteson, *Incremental clustering and expansion for faster
    optimal planning in Dec-POMDPs*, JAIR 46, 2013. The MADP toolbox' file has the same numbers with the actions' names
    in reverse: its ``searchbig`` recharges.

    Args:
        discount: In (0, 1].
    """
    # Per action: (high, low) x the same at the next step. A low battery that is high after a search had run empty.
    battery = np.zeros((3, 2, 2))
    battery[_RECHARGE, :, _HIGH] = 1
    battery[_LITTLE] = [[0.7, 0.3], [0.2, 0.8]]
    battery[_BIG] = [[0.5, 0.5], [0.3, 0.7]]
    rewards = np.zeros((9, 4, 4))
    for joint, actions in enumerate(product(range(3), repeat=2)):
        found = 2.0 * actions.count(_LITTLE) + 5.0 * (actions.count(_BIG) == 2)
        for levels, later in product(np.ndindex(2, 2), repeat=2):
            empty = sum(
                action != _RECHARGE and (before, after) == (_LOW, _HIGH)
                for action, before, after in zip(actions, levels, later, strict=True)
            )
            rewards[joint, 2 * levels[0] + levels[1], 2 * later[0] + later[1]] = -10.0 * empty if empty else found
    return POMDP(
        [np.kron(first, second) for first in battery for second in battery],
        [np.eye(4)] * 9,
        rewards,
        discount=discount,
        states=Space(Factor(f"battery{robot}", ["high", "low"]) for robot in range(2)),
        actions=agents(["waitandrecharge", "searchlittle", "searchbig"]),
        observation_names=agents(["high", "low"]),
        initial_belief=[1, 0, 0, 0],
    )
