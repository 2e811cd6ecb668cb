"""Decisions of a batch of episodes, as arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mdm.beliefs.batch import BatchTracker

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import POMDP
    from mdm.models.matrices import Vector

    Indices = npt.NDArray[np.intp]

ENDED = -1
"""Stands for the action after the end of a plan."""


class Batch(Protocol):
    """The decisions of a batch of episodes."""

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions of episodes that begin in some states; `ENDED` for an empty plan."""
        ...

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions of some episodes.

        Args:
            episodes: Their indices among the running episodes.
            states: The present state of each.
            actions: Its last action.
            seen: The observation after it.
            numbers: From [0, 1), for stochastic policies.
        """
        ...

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Keep some episodes, and drop the others."""
        ...


class TableBatch:
    """Decisions by tables of actions, one per stage.

    Args:
        tables: H x S actions; the last row serves all later stages.
    """

    def __init__(self, tables: Indices) -> None:
        self._tables = tables
        self._stage = 0

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions."""
        self._stage = 0
        first: Indices = self._tables[0, states]
        return first

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions; every time step has a decision, so all episodes are at the same stage."""
        self._stage = min(self._stage + 1, len(self._tables) - 1)
        following: Indices = self._tables[self._stage, states]
        return following

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Nothing is held for single episodes."""


class ProbabilityBatch:
    """Decisions drawn at random.

    Args:
        weights: The probability of each action in each state, A x S.
    """

    def __init__(self, weights: Vector) -> None:
        levels = np.cumsum(weights, axis=0)
        self._levels = levels[:-1] / levels[-1]

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Draw the first actions."""
        drawn: Indices = (self._levels[:, states] <= numbers).sum(axis=0)
        return drawn

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Draw the next actions."""
        return self.begin(states, numbers)

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Nothing is held for single episodes."""


class BeliefBatch:
    """Decisions of a policy over beliefs, which are tracked as a matrix.

    Args:
        policy: The policy, with ``actions_at``.
        model: The model.
    """

    def __init__(self, policy: Any, model: POMDP) -> None:
        self._tracker = BatchTracker(model)
        self._policy = policy

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions."""
        self._tracker.begin(states)
        actions: Indices = self._policy.actions_at(self._tracker.beliefs)
        return actions

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions."""
        self._tracker.update(episodes, actions, seen)
        chosen: Indices = self._policy.actions_at(self._tracker.beliefs[episodes])
        return chosen

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Drop the other episodes' beliefs."""
        self._tracker.keep(which)
