"""Belief filters for small or dense models: a product of the belief with a matrix.

Cost of a step: O(S^2), or by numba O(S) for each state that the belief gives weight to. Without numba the products are
BLAS's, which for some hundred states and more wakes threads of its own: on a busy machine that makes them up to ten
times slower, unless ``OPENBLAS_NUM_THREADS=1`` is set in the environment.
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

__all__ = ["CompiledFoldedFilter", "FoldedFilter", "LikelyFilter"]


class _DenseFilter:
    """What dense filters share: two arrays, of which one is the belief and the other the next one.

    An array that was handed out is not written to again: another takes its place.
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
        """Begin from a belief."""
        self._before = np.zeros(self._size)
        self._handed_out = False
        self._before[belief.states] = belief.probabilities
        self._total = 1.0

    def predict(self, action: int) -> float:
        """Take an action after which nothing is known; return 1."""
        self._before.dot(self._transitions[action], self._after)
        return self._take(float(self._after.sum()))

    def dense(self) -> Vector:
        """Return the belief as an array of S numbers, read-only, which never changes."""
        if self._total != 1:
            self._normalise()
        self._handed_out = True
        self._before.setflags(write=False)
        return self._before

    def support(self) -> Support:
        """Return the belief by its support, as new arrays."""
        (states,) = self._before.nonzero()
        return Support(states, self._before[states] * (1 / self._total))

    def snapshot(self) -> Any:
        """Return the belief as it is held."""
        return [self._before.tobytes(), self._total]

    def restore(self, snapshot: Any) -> None:
        """Go on from a snapshot."""
        data, self._total = snapshot
        self._before = np.frombuffer(data).copy()
        self._handed_out = False

    def _take(self, total: float) -> float:
        """Go on from the next belief, whose sum is given; return by how much it is less than that of the present."""
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
    """Holds P(s', o | s, a) of each action and observation in one matrix, with the false negatives before it.

    Args:
        model: The POMDP.
    """

    def __init__(self, model: POMDP) -> None:
        super().__init__(model)

        def fold(action: int, observation: int) -> Vector:
            joint = dense(model.joint_matrix(action, observation))
            if model.false_negative is not None and observation != model.false_negative:
                joint = model.resolvent(action).values(joint)
            return np.ascontiguousarray(joint)

        actions, observations = range(len(model.action_space)), range(len(model.observation_space))
        self._folded = [[fold(action, observation) for observation in observations] for action in actions]
        self._ones = np.ones(len(model.state_space))

    def step(self, action: int, observation: int) -> float:
        """Take an action and what was observed after it; return P(observation | belief, action)."""
        # Hot path: a product with ones costs a third of a sum, and the belief is divided only when somebody asks.
        after = self._after
        self._before.dot(self._folded[action][observation], after)
        return self._take(after.dot(self._ones).item())

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Take an action after which one of some observations was made, which one is not known; return P of that."""
        after = self._after
        after[:] = 0
        for observation in observations:
            after += self._before.dot(self._folded[action][observation])
        return self._take(float(after.sum()))


class CompiledFoldedFilter(FoldedFilter):
    """The same by numba: half the time for a few states, and states without weight cost nothing.

    Its belief is always normalised: in a compiled loop that costs less than to find out later that it is not.
    """

    def __init__(self, model: POMDP) -> None:
        from mdm.beliefs.kernels import move_normalised  # noqa: PLC0415 - numba takes long to import

        super().__init__(model)
        self._move = move_normalised
        for _ in range(2):  # compiled now, not at the first step: from a belief of ours, and from one handed out
            self._move(self._folded[0][0], self._before, self._after)
            self.dense()

    def step(self, action: int, observation: int) -> float:
        """Take an action and what was observed after it; return P(observation | belief, action)."""
        total = self._move(self._folded[action][observation], self._before, self._after)
        if not total > 0:
            return 0.0
        self._swap()
        return total

    def _take(self, total: float) -> float:
        """Go on from the next belief, whose sum is given."""
        probability = super()._take(total)
        if self._total != 1:
            self._normalise()
        return probability


class LikelyFilter(_DenseFilter):
    """Multiplies with T, and the result with P(o | a, s'): for models of which not all can be held folded.

    Args:
        model: A POMDP whose observations tell of states.
        fast: Whether to use numba.
    """

    def __init__(self, model: POMDP, *, fast: bool) -> None:
        super().__init__(model)
        self._likelihoods = Dynamics(model).likelihoods
        self._move = None
        if fast:
            from mdm.beliefs.kernels import move_likely  # noqa: PLC0415 - numba takes long to import

            self._move = move_likely
            for _ in range(2):  # compiled now, not at the first step: from a belief of ours, and from one handed out
                self._move(self._transitions[0], self._likelihoods[0][0], self._before, self._after)
                self.dense()

    def step(self, action: int, observation: int) -> float:
        """Take an action and what was observed after it; return P(observation | belief, action)."""
        return self._step(action, self._likelihoods[action][observation])

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Take an action after which one of some observations was made, which one is not known; return P of that."""
        return self._step(action, self._likelihoods[action][list(observations)].sum(axis=0))

    def _step(self, action: int, likelihood: Vector) -> float:
        if self._move is not None:
            return self._take(self._move(self._transitions[action], likelihood, self._before, self._after))
        after = self._after
        self._before.dot(self._transitions[action], after)
        after *= likelihood
        return self._take(float(after.sum()))
