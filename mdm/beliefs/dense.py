"""Belief filters for small or dense models: a product of the belief with a matrix.

Cost of a step: O(S^2), or with numba O(S) per state of the support. Without numba the products are those of BLAS, which
uses threads from some hundred states on. On a busy machine that makes them up to ten times slower, unless the
environment has ``OPENBLAS_NUM_THREADS=1``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs.filter import TINY, Support
from mdm.models.dynamics import Dynamics, dense, once

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

__all__ = ["FoldedFilter", "LikelyFilter", "folded"]

_KEPT = 4_000_000
"""The largest total size of the matrices that are kept for sets of observations."""


class _DenseFilter:
    """The base of dense filters: one array for the belief, and one for the next.

    An array that was handed out is replaced, never written to again.
    """

    is_sparse = False

    def __init__(self, model: POMDP) -> None:
        self._size = len(model.state_space)
        self._before = np.zeros(self._size)
        self._after = np.zeros(self._size)
        self._handed_out = False
        self._total = 1.0
        self._transitions = once(Dynamics(model).matrices, dense)

    def load(self, belief: Support) -> None:
        """Load a belief."""
        self._before = np.zeros(self._size)
        self._handed_out = False
        self._before[belief.states] = belief.probabilities
        self._total = 1.0

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        self._before.dot(self._transitions[action], self._after)
        return self._take(float(self._after.sum()))

    def dense(self) -> Vector:
        """Return the belief as an immutable array of S numbers."""
        if self._total != 1:
            self._normalise()
        self._handed_out = True
        self._before.setflags(write=False)
        return self._before

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
        self._before = np.frombuffer(data).reshape(self._size).copy()
        self._handed_out = False

    def _take(self, total: float) -> float:
        """Accept the next belief, given its sum; return the quotient of the two sums."""
        if not total > 0:
            return 0.0
        probability, self._total = total / self._total, total
        self._swap()
        if total < TINY:
            self._normalise()
        return probability

    def _swap(self) -> None:
        self._before, self._after = self._after, np.empty(self._size) if self._handed_out else self._before
        self._handed_out = False

    def _normalise(self) -> None:
        self._before /= self._total
        self._total = 1.0


class FoldedFilter(_DenseFilter):
    """A matrix P(s', o | s, a) per action and observation, including the steps without a detection before it.

    Args:
        model: The POMDP.
    """

    def __init__(self, model: POMDP) -> None:
        super().__init__(model)
        actions, observations = range(len(model.action_space)), range(len(model.observation_space))
        self._folded = [[folded(model, action, observation) for observation in observations] for action in actions]
        self._ones = np.ones(len(model.state_space))
        self._sums: dict[tuple[int, ...], Vector] = {}

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        # Hot path: a product with ones costs a third of a sum, and the belief is normalised only on access.
        after = self._after
        self._before.dot(self._folded[action][observation], after)
        return self._take(after.dot(self._ones).item())

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        after = self._after
        self._before.dot(self._sum(action, observations), after)
        return self._take(after.dot(self._ones).item())

    def _sum(self, action: int, observations: Sequence[int]) -> Vector:
        """Return the matrix of a set of observations; those that were asked for are kept, as far as they are small."""
        key = (action, *observations)
        found = self._sums.get(key)
        if found is None:
            if len(self._sums) >= _KEPT // self._size**2:
                self._sums.clear()
            folded = self._folded[action]
            found = self._sums[key] = np.sum([folded[observation] for observation in observations], axis=0)
        return found


class LikelyFilter(_DenseFilter):
    """Multiplies by T and then by P(o | a, s'), for models too large for a matrix per action and observation.

    Args:
        model: A POMDP without event observations.
        fast: Whether to use numba.
    """

    def __init__(self, model: POMDP, *, fast: bool) -> None:
        super().__init__(model)
        self._told = once([model.observation_matrix(action) for action in range(len(model.action_space))], dense)
        self._move = None
        if fast:
            from mdm.beliefs.kernels import move_likely  # noqa: PLC0415 - numba is slow to import

            self._move = move_likely
            for _ in range(2):  # compiled now, not at the first step: for a writeable and for a read-only belief
                self._move(self._transitions[0], self._likelihood(0, 0), self._before, self._after)
                self.dense()

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        return self._step(action, self._likelihood(action, observation))

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        return self._step(action, self._told[action][:, list(observations)].sum(axis=1))

    def _likelihood(self, action: int, observation: int) -> Vector:
        """Return P(o | a, s') for each s', in a row; to keep all of them would hold O twice."""
        likelihood: Vector = self._told[action][:, observation].copy()
        return likelihood

    def _step(self, action: int, likelihood: Vector) -> float:
        if self._move is not None:
            return self._take(self._move(self._transitions[action], likelihood, self._before, self._after))
        after = self._after
        self._before.dot(self._transitions[action], after)
        after *= likelihood
        return self._take(float(after.sum()))


def folded(model: POMDP, action: int, observation: int) -> Vector:
    """Return P(s', o | s, a) of an action and an observation, S x S', including steps without a detection before it."""
    joint = dense(model.joint_matrix(action, observation))
    if observation != model.false_negative and model.waits_in(action):
        joint = model.resolvent(action).values(joint)
    return np.ascontiguousarray(joint)
