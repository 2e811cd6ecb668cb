"""The tiger problem, for one agent and for two."""

from __future__ import annotations

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP
from mdm.problems.parameters import agents, checked


@checked
def tiger(accuracy: float = 0.85, *, discount: float = 0.95) -> POMDP:
    """Return the tiger problem: two doors, behind one of them a tiger.

    Listening tells the tiger's side, with errors, at a cost of 1. Opening the door without the tiger pays 10, the other
    costs 100; then the tiger is behind a door at random again.

    2 states, 3 actions, 2 observations. Optimal values of the initial belief: 19.3713 at a discount of 0.95, 1.9334 at
    0.75.

    Source: L. P. Kaelbling, M. L. Littman and A. R. Cassandra, *Planning and acting in partially observable stochastic
    domains*, Artificial Intelligence 101, 1998, section 5.1; A. R. Cassandra, L. P. Kaelbling and M. L. Littman,
    *Acting optimally in partially observable stochastic domains*, AAAI 1994, with a discount of 0.75.

    Args:
        accuracy: The probability that listening tells the right side.
        discount: In (0, 1].

    Raises:
        ModelError: If the accuracy is not a probability.
    """
    if not 0 <= accuracy <= 1:
        raise ModelError(f"the accuracy is a probability, not {accuracy}")
    identity, uniform = np.eye(2), np.full((2, 2), 0.5)
    heard = [[accuracy, 1 - accuracy], [1 - accuracy, accuracy]]
    return POMDP(
        [identity, uniform, uniform],
        [heard, uniform, uniform],
        [[-1, -100, 10], [-1, 10, -100]],
        discount=discount,
        states=["tiger-left", "tiger-right"],
        actions=["listen", "open-left", "open-right"],
        observation_names=["hear-left", "hear-right"],
    )


@checked
def dec_tiger(accuracy: float = 0.85, *, left: float = 0.5, discount: float = 1.0) -> POMDP:
    """Return the tiger problem for two agents, who hear each for themselves and open the doors together.

    Listening costs 1 for each agent. A door opened by both pays 20 or costs 50, by one alone pays 10 or costs 100; two
    different doors cost 100. As soon as anybody opens a door, the tiger is put behind a door at random and nothing is
    heard of it.

    2 states, 3 x 3 actions, 2 x 2 observations. Optimal values of decentralised plans without discount: -4 for 2
    decisions, 5.19081 for 3, 4.80276 for 4, 7.02645 for 5, 10.38163 for 6.

    Source: R. Nair, M. Tambe, M. Yokoo, D. Pynadath and S. Marsella, *Taming decentralized POMDPs: towards efficient
    policy computation for multiagent settings*, IJCAI 2003. Values: F. A. Oliehoek, M. T. J. Spaan, C. Amato and S.
    Whiteson, *Incremental clustering and expansion for faster optimal planning in Dec-POMDPs*, JAIR 46, 2013. The
    skewed version of the MADP toolbox has ``left=0.8``.

    Args:
        accuracy: The probability that an agent hears the tiger on the right side.
        left: The probability that the tiger is on the left at the start.
        discount: In (0, 1].
    """
    heard = np.array([[accuracy, 1 - accuracy], [1 - accuracy, accuracy]])
    both_heard = np.einsum("si,sj->sij", heard, heard).reshape(2, 4)
    uniform = np.full((2, 2), 0.5)
    openings = 8  # joint actions but the first, in which both listen
    tiger_left = [-2, -101, 9, -101, -50, -100, 9, -100, 20]
    tiger_right = [-2, 9, -101, 9, 20, -100, -101, -100, -50]
    return POMDP(
        [np.eye(2)] + [uniform] * openings,
        [both_heard] + [np.full((2, 4), 0.25)] * openings,
        [tiger_left, tiger_right],
        discount=discount,
        states=["tiger-left", "tiger-right"],
        actions=agents(["listen", "open-left", "open-right"]),
        observation_names=agents(["hear-left", "hear-right"]),
        initial_belief=[left, 1 - left],
    )
