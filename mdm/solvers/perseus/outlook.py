"""What actions lead to: the model as Perseus reads it, one S x (O S') matrix of P(s', o | s, a) for each action.

A row of it holds all that may follow a state, so that one product takes a block of beliefs to what they become after
each observation, and one product makes vectors of the ones that follow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.compressed import csr, is_compressed
from mdm.solvers.perseus.silence import Silence

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.pomdp import POMDP
    from mdm.solvers.watch import Watch

__all__ = ["Indices", "Only", "Outlook"]

Indices: TypeAlias = npt.NDArray[np.intp]
Only: TypeAlias = tuple[int, Indices]

_SMALL = 20_000
"""Up to so many numbers are kept dense whatever they are."""
_DENSE = 0.2
"""From this part of non-zeros on dense products are faster."""
_WIDE = 300
_NARROW = 0.3
"""For more states than the first, beliefs are sparse that give weight to a smaller part of them than the second."""
_SWEEPS = 2_000
_SETTLED = 1e-6


class Outlook:
    """The dynamics and rewards of a flat model.

    Observations that are left out, and those that events have no name for, are not noticed: the action goes on.

    Args:
        model: The POMDP, flat.
        without: An observation that nobody notices.

    Raises:
        ModelError: If rewards are too large, or an action may go on unnoticed for ever.
    """

    def __init__(self, model: POMDP, without: int | None = None) -> None:
        self.num_actions = len(model.action_space)
        self.size = len(model.state_space)
        self.discount = model.discount
        self.rewards: Vector = np.ascontiguousarray(model.rewards.T)
        """R(s, a): A x S."""
        self.observations = [o for o in range(len(model.observation_space)) if o != without]
        self.width = len(self.observations)
        if not self.width:
            raise ModelError("nothing is ever noticed: the model's only observation is its false negative")
        joints = [[model.joint_matrix(a, o) for o in self.observations] for a in range(self.num_actions)]
        self._compressed = _is_sparse(joints, self.size)
        self._ahead = [self._side_by_side(each) for each in joints]
        self._transitions = [self._own(model.transition_matrix(action)) for action in range(self.num_actions)]
        self._silences: list[Silence | None] = [None] * self.num_actions
        if without is not None or model.event_observations:
            for action, each in enumerate(joints):
                noticed = [self._own(matrix) for matrix in each]
                name = model.action_space.names[action]
                self._silences[action] = Silence.of(self._transitions[action], noticed, self.discount, name)

    def _own(self, matrix: Matrix) -> Matrix:
        """Return a matrix as this model's are."""
        if self._compressed:
            return csr(matrix, copy=False)
        return np.asarray(matrix.toarray() if is_compressed(matrix) else matrix)

    def _side_by_side(self, matrices: list[Matrix]) -> Matrix:
        if not self._compressed:
            return np.hstack([self._own(matrix) for matrix in matrices])
        from scipy.sparse import hstack  # noqa: PLC0415 - takes as long to import as all the rest

        return csr(hstack([self._own(matrix) for matrix in matrices], format="csr"))

    def points(self, beliefs: Vector) -> Matrix:
        """Return beliefs (n x S) as products like them: CSR where that is less to do, else dense."""
        if self._compressed and self.size > _WIDE and np.count_nonzero(beliefs) < _NARROW * beliefs.size:
            return csr(beliefs)
        return np.ascontiguousarray(beliefs)

    def during(self, action: int, points: Matrix) -> Matrix:
        """Return points weighed by all that may go on unnoticed, with its discount, before something is noticed."""
        silence = self._silences[action]
        return points if silence is None else silence.weights(points)

    def after(self, action: int, belief: Vector) -> Vector:
        """Return what a belief becomes after each observation, unnormalised: O x S."""
        return np.asarray(self._ahead[action].T @ belief).reshape(self.width, self.size)

    def follow(self, action: int, points: Matrix, vectors: Vector, only: Only | None = None) -> tuple[Vector, Indices]:
        """Return the best vectors after each observation: what they are worth at points together, n, and which, n x O.

        What cannot be observed is followed by the vector that is best for the uniform belief.

        Args:
            action: The action.
            points: n x S, the weights of the states in which it ends.
            vectors: N x S.
            only: An observation's place, and the vectors that may follow it.
        """
        usual = np.full(self.width, vectors.sum(axis=1).argmax())
        refused: Any = None
        if only is not None:
            refused = np.ones(len(vectors), dtype=bool)
            refused[only[1]] = False
            usual[only[0]] = only[1][vectors[only[1]].sum(axis=1).argmax()]
        return (self._follow_narrow if is_compressed(points) else self._follow_wide)(
            action, points, vectors, usual, -1 if only is None else only[0], refused
        )

    def _follow_wide(
        self, action: int, points: Vector, vectors: Vector, usual: Indices, place: int, refused: Any
    ) -> tuple[Vector, Indices]:
        after = np.asarray(self._ahead[action].T @ points.T).reshape(self.width, self.size, len(points))
        scores = np.matmul(vectors, after)
        if refused is not None:
            scores[place, refused] = -np.inf
        following = scores.argmax(axis=1)
        worth = np.take_along_axis(scores, following[:, None], axis=1)[:, 0]
        return worth.sum(axis=0), np.where(after.any(axis=1), following, usual[:, None]).T

    def _follow_narrow(
        self, action: int, points: Any, vectors: Vector, usual: Indices, place: int, refused: Any
    ) -> tuple[Vector, Indices]:
        shape = points.shape[0], self.width
        after = (points @ self._ahead[action]).reshape(shape[0] * shape[1], self.size).tocsr()
        at = np.flatnonzero(np.diff(after.indptr))
        starts = np.append(after.indptr[at], after.nnz)
        scores = csr((after.data, after.indices, starts), (len(at), self.size), copy=False) @ vectors.T
        if refused is not None:
            scores[np.ix_(at % self.width == place, refused)] = -np.inf
        following = np.tile(usual, shape[0])
        following[at] = scores.argmax(axis=1)
        worth = np.zeros(shape)
        worth.flat[at] = scores[np.arange(len(at)), following[at]]
        return worth.sum(axis=1), following.reshape(shape)

    def vectors(self, action: int, following: Vector) -> Vector:
        """Return the vectors of an action that are followed by others: k x S, of k x O x S."""
        earned = self._ahead[action] @ following.reshape(len(following), -1).T
        earned *= self.discount
        earned += self.rewards[action][:, None]
        silence = self._silences[action]
        return np.ascontiguousarray((earned if silence is None else silence.values(earned)).T)

    def blind_values(self) -> Vector:
        """Return what each action is worth, at least, if it is done for ever: A x S.

        It is approached from below, so that it holds wherever the sweeps end.

        Raises:
            ModelError: If the rewards are too large for numbers.
        """
        result = np.empty_like(self.rewards)
        for action, rewards in enumerate(self.rewards):
            values = np.full(self.size, self._limit(rewards.min()))
            for _ in range(_SWEEPS):
                better = rewards + self.discount * (self._transitions[action] @ values)
                change = np.abs(better - values).max()
                values = better
                if change <= _SETTLED * np.ptp(rewards):
                    break
            result[action] = values
        return result

    def upper_bound(self, belief: Vector, watch: Watch, horizon: int | None = None) -> float:
        """Return the fast informed bound: no policy earns more from a belief.

        It is approached from above (M. Hauskrecht, *Value-function approximations for partially observable Markov
        decision processes*, JAIR 13, 2000, section 4.5), so that it holds wherever the watch ends it. With a horizon it
        is that of so many decisions, and inf where it was ended.

        Raises:
            ModelError: If the rewards are too large for numbers.
        """
        shape = self.num_actions, self.size
        values = np.full(shape, 0.0 if horizon is not None else self._limit(self.rewards.max()))
        rows = [each.reshape(self.size * self.width, self.size) for each in self._ahead]
        for _ in range(_SWEEPS if horizon is None else horizon):
            if watch.remaining < 0:
                if horizon is not None:
                    return np.inf
                break
            columns = np.ascontiguousarray(values.T)
            better = np.empty(shape)
            for action in range(self.num_actions):
                best = (rows[action] @ columns).max(axis=1).reshape(self.size, self.width).sum(axis=1)
                earned = self.rewards[action] + self.discount * best
                silence = self._silences[action]
                better[action] = earned if silence is None else silence.values(earned)
            change = np.abs(better - values).max()
            values = better
            if horizon is None and change <= _SETTLED * np.ptp(values):
                break
        return float((values @ belief).max())

    def _limit(self, reward: float) -> float:
        """Return what a reward in every step is worth."""
        with np.errstate(over="ignore"):
            value = float(np.float64(reward) / (1 - self.discount))
        if not np.abs(value) < np.finfo(np.float64).max / 1e3:
            raise ModelError(f"a reward of {reward:g} in every step is too much for numbers: scale the rewards down")
        return value


def _is_sparse(joints: list[list[Matrix]], size: int) -> bool:
    count = sum(map(len, joints)) * size**2
    if count <= _SMALL:
        return False
    entries = sum(m.nnz if is_compressed(m) else int(np.count_nonzero(m)) for each in joints for m in each)
    return bool(entries < _DENSE * count)
