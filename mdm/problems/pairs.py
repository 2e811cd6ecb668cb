"""Small problems of two agents: a shared channel, cans to collect, packets to hand over."""

from __future__ import annotations

from itertools import product

import numpy as np

from mdm.checks import is_number
from mdm.errors import ModelError
from mdm.models import POMDP, Factor, Space
from mdm.problems.parameters import agents, checked


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


_SHUFFLE, _EXCHANGE, _SENSE = range(3)


@checked
def relay(accuracy: float = 0.9, *, discount: float = 0.95) -> POMDP:
    """Return the problem of two agents in neighbouring rooms, who exchange packets when both are at the door.

    Each room has two places, of which the first is at the door. ``shuffle`` ends in either place; ``sense`` tells with
    errors whether the door is there; ``exchange`` pays 50 if both exchange at the door, whereupon both are anywhere,
    and costs 50 otherwise. Without an exchange a step costs 1.

    4 states (``l1_r2``: the left agent at the door, the right one away from it), 3 x 3 actions, 3 x 3 observations.

    Source: the MADP toolbox, ``relay4.dpomdp``, which names no paper.

    Args:
        accuracy: The probability that sensing tells rightly whether the door is there.
        discount: In (0, 1].
    """
    anywhere, stay = np.full((2, 2), 0.5), np.eye(2)
    moves = [anywhere, stay, stay]
    idle = np.array([[0, 0, 1.0], [0, 0, 1.0]])
    sensed = np.array([[accuracy, 1 - accuracy, 0], [1 - accuracy, accuracy, 0]])
    seen = [idle, idle, sensed]
    transitions, observations, rewards = [], [], np.full((4, 9), -50.0)
    for joint, (left, right) in enumerate(np.ndindex(3, 3)):
        transitions.append(np.kron(moves[left], moves[right]))
        observations.append(np.kron(seen[left], seen[right]))
        if _EXCHANGE not in (left, right):
            rewards[:, joint] = -1
        elif left == right:
            transitions[-1][0] = 0.25
            rewards[0, joint] = 50
    return POMDP(
        transitions,
        observations,
        rewards,
        discount=discount,
        states=["l1_r1", "l1_r2", "l2_r1", "l2_r2"],
        actions=agents(["shuffle", "exchange", "sense"]),
        observation_names=agents(["door", "noDoor", "idle"]),
        initial_belief=[0, 0, 0, 1],
    )
