"""The tiger problem."""

from __future__ import annotations

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP
from mdm.problems.parameters import checked

__all__ = ["tiger"]


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
