"""A belief filter that switches between the support of a belief and all states, by the size of the support."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from mdm.beliefs.filter import Filter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.beliefs.filter import Support
    from mdm.models.matrices import Vector

__all__ = ["AdaptiveFilter", "SizedFilter"]


class SizedFilter(Filter, Protocol):
    """A filter that knows the size of its belief's support."""

    @property
    def size(self) -> int:
        """The size of the support."""
        ...


class AdaptiveFilter:
    """Holds a belief by its support while that is small, else over all states.

    Args:
        narrow: The filter by support.
        wide: The filter over all states.
        most: A larger support switches to the wide filter.
        least: A smaller support switches back.
    """

    def __init__(self, narrow: SizedFilter, wide: SizedFilter, most: int, least: int) -> None:
        self._narrow = narrow
        self._wide = wide
        self._most = most
        self._least = least
        self._present = narrow

    @property
    def is_sparse(self) -> bool:
        """Whether the belief is held by its support."""
        return self._present is self._narrow

    def load(self, belief: Support) -> None:
        """Load a belief."""
        self._present = self._narrow if len(belief.states) <= self._most else self._wide
        self._present.load(belief)

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        probability = self._present.step(action, observation)
        self._switch()
        return probability

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        probability = self._present.step_any(action, observations)
        self._switch()
        return probability

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        probability = self._present.predict(action)
        self._switch()
        return probability

    def dense(self) -> Vector:
        """Return the belief as a new array of S numbers, read-only."""
        return self._present.dense()

    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""
        return self._present.support()

    def snapshot(self) -> Any:
        """Return which filter holds the belief, and its snapshot."""
        return [self.is_sparse, self._present.snapshot()]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        is_sparse, held = snapshot
        self._present = self._narrow if is_sparse else self._wide
        self._present.restore(held)

    def _switch(self) -> None:
        size = self._present.size
        if self._present is self._narrow:
            if size <= self._most:
                return
            other = self._wide
        elif size >= self._least:
            return
        else:
            other = self._narrow
        other.load(self._present.support())
        self._present = other
