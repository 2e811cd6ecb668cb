"""Belief filters: each applies Bayes' rule in the way that suits a kind of model.

A filter holds its belief unnormalised, with its sum: P(observation | belief, action) is the quotient of two sums, and
a step does not pass over the belief to normalise it. It holds it over all states (`WholeFilter`) or by its support
(`SparseFilter`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.models.matrices import Vector  # noqa: TC001 - field types are evaluated

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

_TINY = 1e-100
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


class Filter(ABC):
    """Updates a belief; an observation of probability 0 leaves it unchanged.

    Attributes:
        steps: What makes a step and returns P(observation | belief, action), for each action and observation; None
            where that is made by `step` alone.
    """

    steps: Sequence[Sequence[Callable[[], float]]] | None = None

    @property
    @abstractmethod
    def is_sparse(self) -> bool:
        """Whether the belief is held by its support."""

    @abstractmethod
    def load(self, belief: Support) -> None:
        """Load a belief."""

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        return self.step_any(action, (observation,))

    @abstractmethod
    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""

    @abstractmethod
    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""

    @abstractmethod
    def dense(self) -> Vector:
        """Return the belief as an immutable array of S numbers."""

    @abstractmethod
    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""

    @abstractmethod
    def snapshot(self) -> Any:
        """Return the exact internal form of the belief, made of numbers, bytes and lists."""

    @abstractmethod
    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot of a filter of the same kind and model."""


class WholeFilter(Filter):
    """The base of filters over all states: one array for the belief, and one for the next.

    An array that was handed out is replaced, never written to again.
    """

    is_sparse = False

    def __init__(self, num_states: int) -> None:
        self._before = np.zeros(num_states)
        self._after = np.zeros(num_states)
        self._handed_out = False
        self._total = 1.0

    def load(self, belief: Support) -> None:
        """Load a belief."""
        if self._handed_out:
            self._before, self._handed_out = np.empty_like(self._before), False
        self._before[:] = 0
        self._before[belief.states] = belief.probabilities
        self._total = 1.0

    def dense(self) -> Vector:
        """Return the belief as a new array of S numbers, read-only."""
        belief = self._before * (1 / self._total)
        belief.flags.writeable = False
        return belief

    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""
        (states,) = self._before.nonzero()
        return Support(states, self._before[states] * (1 / self._total))

    def snapshot(self) -> Any:
        """Return the internal form of the belief."""
        return [self._before.tobytes(), self._total]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        data, self._total = snapshot
        self._before = np.frombuffer(data).reshape(self._before.shape).copy()
        self._handed_out = False

    def _take(self, total: float) -> float:
        """Accept the next belief, given its sum; return the quotient of the two sums."""
        if not total > 0:
            return 0.0
        probability, self._total = total / self._total, total
        self._before, self._after = self._after, np.empty_like(self._before) if self._handed_out else self._before
        self._handed_out = False
        if total < _TINY:
            self._normalise()
        return probability

    def _normalise(self) -> None:
        self._before /= self._total
        self._total = 1.0


class SparseFilter(Filter):
    """The base of filters by support: the states of non-zero probability, in any order, and their values.

    Attributes:
        size: The size of the support.
    """

    is_sparse = True

    def __init__(self, num_states: int) -> None:
        self._num_states = num_states
        self._states: npt.NDArray[Any] = np.empty(0, np.intp)
        self._values = np.empty(0)
        self._total = 1.0
        self.size = 0

    def load(self, belief: Support) -> None:
        """Load a belief."""
        self._keep(belief.states, belief.probabilities)
        self._total = 1.0

    def dense(self) -> Vector:
        """Return the belief as a new array of S numbers, read-only."""
        return self.support().dense(self._num_states)

    def support(self) -> Support:
        """Return the support of the belief, as new arrays."""
        size = self.size
        return Support(self._states[:size].astype(np.intp), self._values[:size] * (1 / self._total))

    def snapshot(self) -> Any:
        """Return the internal form of the belief."""
        size = self.size
        return [self._states[:size].astype(np.int64).tobytes(), self._values[:size].tobytes(), self._total]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        states, values, total = snapshot
        places = np.frombuffer(states, np.int64)
        self._keep(places, np.frombuffer(values).reshape(places.shape).copy())
        self._total = total

    def _keep(self, states: npt.NDArray[Any], values: Vector) -> None:
        """Hold the next belief, unnormalised."""
        self._states, self._values, self.size = states, values, len(states)

    def _take(self, total: float) -> float:
        """Accept the next belief, which is held already, given its sum; return the quotient of the two sums."""
        probability, self._total = total / self._total, total
        if total < _TINY:
            self._values[: self.size] /= total
            self._total = 1.0
        return probability
