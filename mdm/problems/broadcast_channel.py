"""The broadcast channel: two nodes that share a channel for their messages."""

from __future__ import annotations

import numpy as np

from mdm.checks import is_number
from mdm.errors import ModelError
from mdm.models import POMDP
from mdm.problems.parameters import agents, checked

__all__ = ["broadcast_channel"]


@checked
def broadcast_channel(
    arrivals: tuple[float, float] = (0.9, 0.1), *, accuracy: float = 0.9, discount: float = 1.0
) -> POMDP:
    """Return the control of a broadcast channel by two nodes, each with room for one message.

    A node sends or waits. One message gets through, and pays 1, if one node alone sends and has a message; what two
    nodes send at once is lost. A node that has sent, or has no message, may get a new one. Each node then hears whether
    there was a collision, with errors.

    4 states (``S10``: the first node has a message, the second has none), 2 x 2 actions, 2 x 2 observations. Optimal
    values of decentralised plans: 2 for 2 decisions, 2.99 for 3, 3.89 for 4, 4.79 for 5, 5.69 for 6, 9.29 for 10.

    Source: E. A. Hansen, D. S. Bernstein and S. Zilberstein, *Dynamic programming for partially observable stochastic
    games*, AAAI 2004, after J. M. Ooi and G. W. Wornell, *Decentralized control of a multiple access broadcast channel:
    performance bounds*, CDC 1996; with the observations of the MADP toolbox. Values: F. A. Oliehoek, M. T. J. Spaan, C.
    Amato and S. Whiteson, *Incremental clustering and expansion for faster optimal planning in Dec-POMDPs*, JAIR 46,
    2013.

    Args:
        arrivals: For each node the probability of a new message.
        accuracy: The probability that a node hears rightly whether there was a collision.
        discount: In (0, 1].

    Raises:
        ModelError: If there are not two probabilities of a message.
    """
    if not isinstance(arrivals, list | tuple) or len(arrivals) != 2 or not all(map(is_number, arrivals)):
        raise ModelError(f"two nodes share the channel: give a probability of a message for each, not {arrivals!r}")
    send, full = 0, 1
    # Per node: its actions x (no message, a message) x the same at the next step.
    filled = [
        np.array([[[1 - arrival, arrival], [1 - arrival, arrival]], [[1 - arrival, arrival], [0, 1]]])
        for arrival in arrivals
    ]
    transitions, observations, rewards = [], [], np.zeros((2, 2, 4))
    for first, second in np.ndindex(2, 2):
        transitions.append(np.kron(filled[0][first], filled[1][second]))
        collision = first == second == send
        heard = [accuracy, 1 - accuracy] if collision else [1 - accuracy, accuracy]
        observations.append(np.tile(np.kron(heard, heard), (4, 1)))
        if first != second:
            sender = 0 if first == send else 1
            rewards[first, second] = [np.unravel_index(state, (2, 2))[sender] == full for state in range(4)]
    return POMDP(
        transitions,
        observations,
        rewards.reshape(4, 4).T,
        discount=discount,
        states=["S00", "S01", "S10", "S11"],
        actions=agents(["send", "wait"]),
        observation_names=agents(["Collision", "No-Collision"]),
        initial_belief=[0, 0, 0, 1],
    )
