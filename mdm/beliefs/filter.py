"""What belief filters have in common: each moves a belief by Bayes' rule, in the way that suits a kind of model.

A filter holds its belief unnormalised, with its sum: P(observation | belief, action) is the quotient of two sums, and
no step needs a pass over the belief to divide by it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from mdm.models.matrices import Vector  # noqa: TC001 - the fields' types are looked at

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

__all__ = ["TINY", "Filter", "Support"]

TINY = 1e-100
"""A belief whose sum has become smaller than this is normalised, before small probabilities are lost."""


class Support(NamedTuple):
    """The states that a belief gives weight to, in no particular order, and their probabilities."""

    states: npt.NDArray[np.intp]
    probabilities: Vector

    def dense(self, size: int) -> Vector:
        """Return the belief as an array of S numbers, read-only."""
        belief = np.zeros(size)
        belief[self.states] = self.probabilities
        belief.flags.writeable = False
        return belief


class Filter(Protocol):
    """Moves a belief; where what is observed has probability 0, it stays as it was."""

    @property
    def is_sparse(self) -> bool:
        """Whether the belief is held by its support."""
        ...

    def load(self, belief: Support) -> None:
        """Begin from a belief."""
        ...

    def step(self, action: int, observation: int) -> float:
        """Take an action and what was observed after it; return P(observation | belief, action)."""
        ...

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Take an action after which one of some observations was made, which one is not known; return P of that."""
        ...

    def predict(self, action: int) -> float:
        """Take an action after which nothing is known; return 1."""
        ...

    def dense(self) -> Vector:
        """Return the belief as an array of S numbers, read-only, which never changes."""
        ...

    def support(self) -> Support:
        """Return the belief by its support, as new arrays."""
        ...

    def snapshot(self) -> Any:
        """Return the belief as it is held, bit by bit, of numbers, bytes and lists."""
        ...

    def restore(self, snapshot: Any) -> None:
        """Go on from a snapshot of a filter of the same kind and model."""
        ...
