"""Forest management: cut, or wait for old trees and risk a fire."""

from __future__ import annotations

import numpy as np

from mdm.errors import ModelError
from mdm.models import MDP
from mdm.problems.parameters import checked

__all__ = ["forest"]


@checked
def forest(
    ages: int = 3, *, fire: float = 0.1, old_reward: float = 4.0, cut_reward: float = 2.0, discount: float = 0.9
) -> MDP:
    """Return the forest problem: whether to cut a forest or to let it grow, under the risk of fire.

    Waiting makes the forest a class older, unless a fire burns it down; the oldest class pays for being left alone.
    Cutting pays 1, nothing for the youngest class, and another sum for the oldest.

    As many states as there are ages, 2 actions. By default the values of the states are 26.244, 29.484 and 33.484:
    never cut.

    Source: the example of I. Chadès, G. Chapron, M.-J. Cros, F. Garcia and R. Sabbadin, *MDPtoolbox: a multi-platform
    toolbox to solve stochastic dynamic programming problems*, Ecography 37, 2014.

    Args:
        ages: How many classes of age there are; at least 2.
        fire: The probability of a fire in a year without cutting.
        old_reward: What leaving the oldest forest alone pays.
        cut_reward: What cutting the oldest forest pays.
        discount: In (0, 1].

    Raises:
        ModelError: If there are fewer than two ages, or the risk of fire is not a probability.
    """
    if ages < 2:
        raise ModelError(f"a forest needs at least two classes of age, not {ages}")
    if not 0 <= fire <= 1:
        raise ModelError(f"the risk of fire is a probability, not {fire}")
    age = np.arange(ages)
    wait, cut = np.zeros((2, ages, ages))
    wait[age, np.minimum(age + 1, ages - 1)] = 1 - fire
    wait[:, 0] += fire
    cut[:, 0] = 1
    rewards = np.zeros((ages, 2))
    rewards[-1, 0] = old_reward
    rewards[1:, 1] = 1
    rewards[-1, 1] = cut_reward
    return MDP(
        [wait, cut],
        rewards,
        discount=discount,
        states=[f"age-{number}" for number in age],
        actions=["wait", "cut"],
        initial_belief=np.eye(ages)[0],
    )
