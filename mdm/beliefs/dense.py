"""Belief filters for small or dense models: a product of the belief with a matrix.

Cost of a step: O(S^2), or with numba O(S) per state of the support. Without numba the products are those of BLAS, which
uses threads from some hundred states on. On a busy machine that makes them up to ten times slower, unless the
environment has ``OPENBLAS_NUM_THREADS=1``.

For a few states compiled code takes longer to receive an array than to use it. So `CompactFilter` holds the belief and
all that it is multiplied by in one array. Cost of a step: O(S) per state of the support, or O(non-zeros of these
states' rows of T) where most of T is zero.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs.filter import WholeFilter
from mdm.compilation import direct
from mdm.models.dynamics import Dynamics, dense, once
from mdm.models.matrices import csr, num_entries

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from mdm.models.matrices import Matrix, Vector
    from mdm.models.pomdp import POMDP

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


# -- By numba ----------------------------------------------------------------------------------------------------------

LINE = 8
"""How many numbers a line of the processor's cache holds. Where rows begin with one, a product is a third faster."""
_SPARSE = 0.1
"""The density of the matrices from which none of their zeros are left out."""
_ANY, _FIRST = 2, 3
"""The rows of the likelihood of several observations, and of the first one: see `kernels.move_dense`."""
_MOST_KEPT = 1024
"""Sets of observations of which the likelihood is kept."""
_LARGEST_KEPT = 256
"""The most observations in a set that is kept."""


class CompactFilter(WholeFilter):
    """Multiplies by T and P(o | a, s'); for events and false negatives, by a matrix per action and observation.

    Its belief is always normalised: in a compiled loop that is cheaper than a check on access.

    Args:
        model: The POMDP.
    """

    def __init__(self, model: POMDP) -> None:
        from mdm.beliefs.kernels import move_dense, move_sparse  # noqa: PLC0415 - numba is slow to import

        super().__init__(len(model.state_space))
        dynamics = Dynamics(model)
        size = dynamics.num_states
        moves = _moves(dynamics, model)
        ones = np.ones(size)
        predictions = [(matrix, ones) for matrix in dynamics.matrices]
        every = [*predictions, *(move for each in moves for move in each)]
        matrices = {id(matrix): matrix for matrix, _ in every}
        likelihoods = {id(likelihood): likelihood for _, likelihood in every}
        is_dense = sum(map(num_entries, matrices.values())) >= _SPARSE * len(matrices) * size**2
        width = -(-size // LINE) * LINE
        beyond = ((0, 0), (0, width - size))
        blocks = [np.pad(dense(each), beyond) if is_dense else _pairs(each, width) for each in matrices.values()]
        rows = dict(zip(likelihoods, range(_FIRST, _FIRST + len(likelihoods)), strict=True))
        first = _FIRST + len(likelihoods)
        starts = np.cumsum([first, *(len(block) for block in blocks)]).tolist()
        places = dict(zip(matrices, starts, strict=False))
        numbers = np.zeros(starts[-1] * width + LINE)
        before = -(numbers.ctypes.data // numbers.itemsize) % LINE  # so that it begins with a line of the cache
        self._room = room = numbers[before : before + starts[-1] * width].reshape(-1, width)
        room[_FIRST:first, :size] = list(likelihoods.values())
        for start, block in zip(starts, blocks, strict=False):
            room[start : start + len(block)] = block
        self._before = room[0, :size]
        self._run: Any = direct(move_dense if is_dense else move_sparse, room, 0, 0)

        def found(pairs: Iterable[tuple[Matrix, Vector]]) -> list[tuple[int, int]]:
            return [(places[id(matrix)], rows[id(likelihood)]) for matrix, likelihood in pairs]

        self._predictions = found(predictions)
        self._moves = [found(each) for each in moves]
        self._sums: dict[tuple[int, tuple[int, ...]], Vector] = {}
        self.steps: list[list[Callable[[], float]]] = [
            [partial(self._run, room, *move) for move in each] for each in self._moves
        ]

    def step(self, action: int, observation: int) -> float:
        """Update by an action and an observation; return P(observation | belief, action)."""
        return self.steps[action][observation]()

    def step_any(self, action: int, observations: Sequence[int]) -> float:
        """Update by an action and a set of possible observations; return their probability."""
        room, key = self._room, (action, tuple(observations))
        likelihood = self._sums.get(key)
        if likelihood is not None:  # a team's agents observe at different times: the same sets come again and again
            room[_ANY] = likelihood
            return float(self._run(room, self._moves[action][observations[0]][0], _ANY))
        moves = [self._moves[action][observation] for observation in observations]
        belief = self._before
        (place, _), *others = moves
        if all(other == place for other, _ in others):
            room[_ANY] = likelihood = room[[row for _, row in moves]].sum(axis=0)
            if len(moves) <= _LARGEST_KEPT:
                if len(self._sums) >= _MOST_KEPT:
                    self._sums.clear()
                self._sums[key] = likelihood
            return float(self._run(room, place, _ANY))
        before, after = belief.copy(), np.zeros(len(belief))
        for move in moves:
            self._run(room, *move)
            after += room[1, : len(after)]
            belief[:] = before
        total = float(after.sum())
        if not total > 0:
            return 0.0
        np.divide(after, total, out=belief)
        return total

    def predict(self, action: int) -> float:
        """Predict: update by an action without an observation; return 1."""
        return float(self._run(self._room, *self._predictions[action]))

    def dense(self) -> Vector:
        """Return the belief as an immutable array of S numbers."""
        return np.frombuffer(self._before.tobytes())  # half the time of a copy and its flag

    def snapshot(self) -> Any:
        """Return the bytes of the belief."""
        return self._before.tobytes()

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        self._before[:] = np.frombuffer(snapshot).reshape(self._before.shape)


def _moves(dynamics: Dynamics, model: POMDP) -> list[list[tuple[Matrix, Vector]]]:
    """Return the matrix and the likelihood of each action and observation."""
    if not dynamics.moves_by_joints:
        told = dynamics.likelihoods
        return [[(matrix, row) for row in rows] for matrix, rows in zip(dynamics.matrices, told, strict=True)]
    ones = np.ones(dynamics.num_states)
    actions, observations = range(dynamics.num_actions), range(dynamics.num_observations)
    return [[(folded(model, a, o), ones) for o in observations] for a in actions]


def _pairs(matrix: Matrix, width: int) -> Vector:
    """Return a matrix as `kernels.move_sparse` takes it, in rows of some width."""
    rows = csr(matrix)
    size = rows.shape[0]
    used = size + 1 + 2 * rows.nnz
    block = np.zeros(-(-used // width) * width)
    whole = block.view(np.uint64)
    whole[: size + 1] = size + 1 + 2 * rows.indptr.astype(np.uint64)
    whole[size + 1 : used : 2] = rows.indices
    block[size + 2 : used : 2] = rows.data
    return block.reshape(-1, width)
