"""Belief filters: each applies Bayes' rule in the way that suits a kind of model.

A filter holds its belief unnormalised, with its sum: P(observation | belief, action) is the quotient of two sums, and
a step does not pass over the belief to normalise it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from mdm.models.matrices import Vector  # noqa: TC001 - field types are evaluated

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

__all__ = ["TINY", "Filter", "Support"]

TINY = 1e-100
"""A belief with a smaller sum is normalised, before small probabilities underflow."""


class Support(NamedTuple):
    """The support of a belief: the states with non-zero probability, in any order, and their probabilities.

    Example::

        tracker = mdm.BeliefTracker(mdm.problems.tiger())
        tracker.reset(mdm.beliefs.Support([1], [1.0]))
        tracker.belief  # [0.0, 1.0]
    """

    states: npt.NDArray[np.intp]
    probabilities: Vector

    def dense(self, size: int) -> Vector:
        """Return the belief as an array of S numbers, read-only."""
        belief = np.zeros(size)
        belief[self.states] = self.probabilities
        belief.flags.writeable = False
        return belief


class Filter(Protocol):
    """Updates a belief; an observation of probability 0 leaves it unchanged."""

    @property
    def is_sparse(self) -> bool:
        """Whether the belief is held by its support."""
        ...

    def load(self, belief: Support) -> None:
        """Load a belief."""
        ...

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        ...

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        ...

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        ...

    def dense(self) -> Vector:
        """Return the belief as an immutable array of S numbers."""
        ...

    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""
        ...

    def snapshot(self) -> Any:
        """Return the exact internal form of the belief, made of numbers, bytes and lists."""
        ...

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot of a filter of the same kind and model."""
        ...
