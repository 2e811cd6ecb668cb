"""R(s, a) of a factored model, computed where it is read: in one state, or in those that a belief holds possible."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.factored.flattening import rewards_at

if TYPE_CHECKING:
    from typing import Any

    import numpy.typing as npt

    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.matrices import Vector

__all__ = ["RewardRow", "RewardRows"]


class RewardRows:
    """R as a row over the states for each action, none of which is made.

    Args:
        network: The network.
    """

    def __init__(self, network: TwoSliceNetwork) -> None:
        self._network = network

    def __getitem__(self, action: int) -> RewardRow:
        return RewardRow(self._network, action)


class RewardRow:
    """R(s, a) of one action; it is read as an array of S numbers is.

    Args:
        network: The network.
        action: The joint action.
    """

    __slots__ = ("_action", "_network")

    def __init__(self, network: TwoSliceNetwork, action: int) -> None:
        self._network = network
        self._action = action

    def take(self, states: npt.NDArray[np.intp]) -> Vector:
        """Return the rewards in some states."""
        return rewards_at(self._network, self._action, np.asarray(states))

    def item(self, state: int) -> float:
        """Return the reward in a state."""
        return float(self.take(np.array([state]))[0])

    def dot(self, belief: Vector) -> np.float64:
        """Return the expected reward, for a belief of S numbers."""
        (states,) = belief.nonzero()
        result: Any = self.take(states).dot(belief[states])
        return np.float64(result)
