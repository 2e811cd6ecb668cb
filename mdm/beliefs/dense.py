"""Belief filters for small or dense models: a product of the belief with a matrix.

Cost of a step: O(S^2), or with numba O(S) per state of the support. Without numba the products are those of BLAS, which
uses threads from some hundred states on. On a busy machine that makes them up to ten times slower, unless the
environment has ``OPENBLAS_NUM_THREADS=1``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.beliefs.filter import WholeFilter
from mdm.models.dynamics import Dynamics, dense, once

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

__all__ = ["FoldedFilter", "LikelyFilter", "folded"]

_KEPT = 4_000_000
"""The largest total size of the matrices that are kept for sets of observations."""


class _DenseFilter(WholeFilter):
    """The base of dense filters, which hand out the belief that they hold."""

    def __init__(self, model: POMDP) -> None:
        super().__init__(len(model.state_space))
        self._transitions = once(Dynamics(model).matrices, dense)

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
            if len(self._sums) >= _KEPT // len(self._before) ** 2:
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
