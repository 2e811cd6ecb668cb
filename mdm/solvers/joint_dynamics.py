"""The joint dynamics: one matrix of P(s', o | s, a) for each action.

It has a row for each s, and a column for each pair of o and s' that is possible. One product moves a block of beliefs
along all observations; one product with the vectors that follow makes the vectors of a backup.

Steps before the next detection are summed: with S(s, s') the probability of a step without a detection, and g the
discount, an action with reward r in a step has reward (I - g S)^-1 r up to the detection, whose probabilities are
multiplied by the same matrix (J. V. Messias, M. T. J. Spaan and P. U. Lima, *Asynchronous execution in multiagent
POMDPs: reasoning over partially-observable events*, MSDM 2013).
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics, Indices, Joint
from mdm.models.events import Resolvent, is_rounding
from mdm.models.matrices import ROUNDING, csr, is_compressed
from mdm.solvers.bounds import InformedBound

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector

Only: TypeAlias = tuple[int, Indices]

_SMALL = 20_000
"""Up to so many numbers are kept dense in any case."""
_DENSE = 0.2
"""From this part of non-zeros on dense products are faster."""
_WIDE = 300
_NARROW = 0.3
"""With more states than the first, beliefs are sparse if their supports are less than this share of the states."""
_TOGETHER = 8_000_000
"""The most numbers that are gathered at once for a backup."""
_ENDLESS = 1e9


class JointDynamics:
    """P(s', o | s, a) and R of a model, for products.

    Where the model has false negatives, or events without an observation, the action goes on after these. Rows whose
    probabilities sum to 1 but for rounding are scaled to.

    Args:
        dynamics: The model.
        false_negative: The observation that is a false negative: it is left out.

    Raises:
        ModelError: If an action may go on for ever without a detection, and the discount is 1.
    """

    def __init__(self, dynamics: Dynamics, false_negative: int | None = None) -> None:
        self.dynamics = dynamics
        self.num_actions, self.size = dynamics.num_actions, dynamics.num_states
        self.discount = dynamics.discount
        self.rewards: Vector = np.ascontiguousarray(dynamics.rewards.T)
        """R(s, a): A x S."""
        self.observations = [o for o in range(dynamics.num_observations) if o != false_negative]
        self.width = len(self.observations)
        place = np.full(dynamics.num_observations + 1, -1)
        place[self.observations] = np.arange(self.width)
        self.joints: list[Joint] = []
        """P(s', o | s, a) of each action without false negatives; an observation is its place in ``observations``."""
        self._is_scaled = False
        missed: list[Matrix | None] = []
        for action in range(self.num_actions):
            joint = dynamics.joint(action)
            places = place[joint.observations]
            detected = places >= 0
            missed.append(None if detected.all() else joint.only(~detected).summed())
            self.joints.append(joint.only(detected)._replace(observations=places[detected]))
        entries = sum(joint.rows.nnz for joint in self.joints)
        count = self.num_actions * self.width * self.size**2
        self._compressed = count > _SMALL and entries < _DENSE * count
        self._resolvents: list[Resolvent | None] = [
            discounted_resolvent(steps if steps is None else self._own(steps), self.discount, name)
            for steps, name in zip(missed, dynamics.model.action_space.names, strict=True)
        ]
        for action, steps in enumerate(missed):
            self._scale(action, steps if self._resolvents[action] is not None else None)
        self.ahead: list[Matrix] = []
        """P(s', o | s, a) of each action: a row for each s, a column for each o and s' that go together."""
        self._symbols: list[Indices] = []
        self._successors: list[Indices] = []
        for joint in self.joints:
            matrix = joint.side_by_side(self.width)
            columns, matrix.indices = np.unique(matrix.indices, return_inverse=True)  # without empty ones
            symbols, successors = np.divmod(columns, self.size)
            self.ahead.append(self._own(csr((matrix.data, matrix.indices, matrix.indptr), (self.size, len(columns)))))
            self._symbols.append(symbols)
            self._successors.append(successors)

    def _scale(self, action: int, missed: Matrix | None) -> None:
        """Let the probabilities after an action sum to 1, with the steps after which the action goes on."""
        joint = self.joints[action]
        told = np.asarray(joint.rows.sum(axis=1)).ravel()
        sums = np.bincount(joint.states, told, minlength=self.size)
        left = np.ones(self.size)
        if missed is not None:
            left = np.maximum(left - np.asarray(missed.sum(axis=1)).ravel(), 0.0)
        if (np.abs(sums - left)[sums > 0] > ROUNDING).any():
            self._is_scaled = True
            shares = np.divide(left, sums, out=np.ones(self.size), where=sums > 0)
            lengths = np.diff(joint.rows.indptr)
            parts = joint.rows.data * np.repeat(shares[joint.states], lengths), joint.rows.indices, joint.rows.indptr
            self.joints[action] = joint._replace(rows=csr(parts, joint.rows.shape))

    @property
    def informed(self) -> InformedBound:
        """The backups of the fast informed bound."""
        if self.waits:
            return InformedBound(self.dynamics, self.joints, self.earned)
        return InformedBound(self.dynamics, self.joints if self._is_scaled else None)

    def _own(self, matrix: Any) -> Matrix:
        """Return a CSR matrix as this model's are."""
        return matrix if self._compressed else matrix.toarray()

    @property
    def waits(self) -> bool:
        """Whether an action may go on without a detection."""
        return any(resolvent is not None for resolvent in self._resolvents)

    def waits_in(self, action: int) -> bool:
        """Return whether this action may go on without a detection."""
        return self._resolvents[action] is not None

    def columns(self, action: int) -> tuple[Indices, Indices]:
        """Return the place of the observation and the state of each column of ``ahead``."""
        return self._symbols[action], self._successors[action]

    def points(self, beliefs: Vector) -> Matrix:
        """Return beliefs (n x S) in the faster form for products, CSR or dense."""
        if self._compressed and self.size > _WIDE and np.count_nonzero(beliefs) < _NARROW * beliefs.size:
            return csr(beliefs)
        return np.ascontiguousarray(beliefs)

    def during(self, action: int, points: Matrix) -> Matrix:
        """Return points times the discounted steps that may come before a detection."""
        resolvent = self._resolvents[action]
        return points if resolvent is None else resolvent.weights(points)

    def after(self, action: int, belief: Vector) -> tuple[Indices, Indices, Vector]:
        """Return the joint probabilities after a belief, with their observations' places and states."""
        row = (csr(belief[None]) if self._compressed else belief[None]) @ self.ahead[action]
        weights = row.toarray()[0] if is_compressed(row) else row[0]
        return self._symbols[action], self._successors[action], weights

    def apart(self, action: int, rows: Any) -> tuple[Any, Indices]:
        """Return rows over columns of an action's matrix as rows over s', one for each observation that is possible.

        Args:
            action: The action.
            rows: CSR.

        Returns:
            The new rows, and the place of each: that of the old row times O, plus that of the observation.
        """
        rows.sort_indices()
        owners = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
        keys = owners * self.width + self._symbols[action][rows.indices]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        parts = (rows.data, self._successors[action][rows.indices], np.append(first, len(keys)))
        return csr(parts, (len(first), self.size), copy=False), keys[first]

    def follow(self, action: int, points: Matrix, vectors: Vector, only: Only | None = None) -> tuple[Vector, Indices]:
        """Return the value of the best vectors after each observation (n numbers), and which these are (n x O).

        An impossible observation is followed by the best vector at the uniform belief.

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
        after = np.asarray(self.ahead[action].T @ points.T)
        values = np.zeros(len(points))
        following = np.repeat(usual[None], len(points), axis=0)
        bounds = np.searchsorted(self._symbols[action], np.arange(self.width + 1)).tolist()
        for observation, (first, last) in enumerate(pairwise(bounds)):
            if first == last:
                continue
            part = after[first:last]
            scores = vectors[:, self._successors[action][first:last]] @ part
            if observation == place:
                scores[refused] = -np.inf
            possible = part.any(axis=0)
            chosen = scores.argmax(axis=0)
            following[possible, observation] = chosen[possible]
            values += np.where(possible, scores[chosen, np.arange(len(points))], 0.0)
        return values, following

    def _follow_narrow(
        self, action: int, points: Any, vectors: Vector, usual: Indices, place: int, refused: Any
    ) -> tuple[Vector, Indices]:
        shape = points.shape[0], self.width
        after, at = self.apart(action, points @ self.ahead[action])
        scores = after @ np.ascontiguousarray(vectors.T)
        if refused is not None:
            scores[np.ix_(at % self.width == place, refused)] = -np.inf
        following = np.tile(usual, shape[0])
        following[at] = scores.argmax(axis=1)
        values = np.zeros(shape)
        values.flat[at] = scores[np.arange(len(at)), following[at]]
        return values.sum(axis=1), following.reshape(shape)

    def vectors(self, action: int, vectors: Vector, following: Indices) -> Vector:
        """Return the vectors of an action that are followed by others: k x S, of N x S and k x O."""
        most = max(1, _TOGETHER // max(1, len(self._symbols[action])))
        if len(following) > most:
            return np.concatenate(
                [
                    self.vectors(action, vectors, following[first : first + most])
                    for first in range(0, len(following), most)
                ]
            )
        gathered = vectors[following[:, self._symbols[action]], self._successors[action]]
        earned = self.ahead[action] @ np.ascontiguousarray(gathered.T)
        earned *= self.discount
        earned += self.rewards[action][:, None]
        return np.ascontiguousarray(self.earned(action, earned).T)

    def earned(self, action: int, values: Vector) -> Vector:
        """Return the values of an action up to and after the next detection, of those of a single step."""
        resolvent = self._resolvents[action]
        return values if resolvent is None else resolvent.values(values)


def discounted_resolvent(steps: Matrix | None, discount: float, name: str) -> Resolvent | None:
    """Return the resolvent of an action's steps without a detection; None where every event is detected.

    Args:
        steps: The probabilities of these steps, S x S', dense or CSR; None where there are none.
        discount: Of a step.
        name: The action's.

    Raises:
        ModelError: If the discount is 1 and nothing may ever be detected.
    """
    if steps is None or is_rounding(steps):
        return None
    endless = f"the discount is 1, and action {name!r} may go on for ever without anything being detected"
    try:
        resolvent = Resolvent(discount * steps)
    except (np.linalg.LinAlgError, RuntimeError):
        raise ModelError(endless) from None
    if not np.abs(resolvent.values(np.ones(steps.shape[0]))).max() < _ENDLESS / max(1 - discount, 1e-6):
        raise ModelError(endless)
    return resolvent
