"""The relay problem: two agents who hand over a packet through a door."""

from __future__ import annotations

import numpy as np

from mdm.models import POMDP
from mdm.problems.parameters import agents, checked

__all__ = ["relay"]

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
