"""A belief filter that changes, as a belief grows and shrinks, between holding its support and holding all states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from mdm.beliefs.filter import Filter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.beliefs.filter import Support
    from mdm.models.matrices import Vector

__all__ = ["AdaptiveFilter", "SizedFilter"]


class SizedFilter(Filter, Protocol):
    """A filter that knows how many states its belief gives weight to."""

    @property
    def size(self) -> int:
        """How many these are."""
        ...


class AdaptiveFilter:
    """Holds a belief by its support as long as that is small, and over all states while it is not.

    Args:
        narrow: By the support.
        wide: Over all states.
        most: With more states than this a belief becomes wide.
        least: With fewer it becomes narrow again.
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
        """Begin from a belief."""
        self._present = self._narrow if len(belief.states) <= self._most else self._wide
        self._present.load(belief)

    def step(self, action: int, observation: int) -> float:
        """Take an action and what was observed after it; return P(observation | belief, action)."""
        probability = self._present.step(action, observation)
        self._switch()
        return probability

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Take an action after which one of some observations was made, which one is not known; return P of that."""
        probability = self._present.step_any(action, observations)
        self._switch()
        return probability

    def predict(self, action: int) -> float:
        """Take an action after which nothing is known; return 1."""
        probability = self._present.predict(action)
        self._switch()
        return probability

    def dense(self) -> Vector:
        """Return the belief as a new array of S numbers, read-only."""
        return self._present.dense()

    def support(self) -> Support:
        """Return the belief by its support, as new arrays."""
        return self._present.support()

    def snapshot(self) -> Any:
        """Return the belief as it is held, and how."""
        return [self.is_sparse, self._present.snapshot()]

    def restore(self, snapshot: Any) -> None:
        """Go on from a snapshot."""
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
