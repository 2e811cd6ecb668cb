"""Steps: what a controller decides."""

from __future__ import annotations

import msgspec

__all__ = ["Step"]


class Step(msgspec.Struct, frozen=True, gc=False):
    """A decision.

    Attributes:
        epoch: Its number in the episode, from 0.
        action: The (joint) action's index.
        action_name: Its name.
        reward: The expected immediate reward; None if it is not known.
        probability: P(observation | information, action) of the observation before; 0 if it was impossible, None at
            the start and for policies over states.
    """

    epoch: int
    action: int
    action_name: str
    reward: float | None
    probability: float | None = None
