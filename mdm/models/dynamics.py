"""Dynamics: T, O and R of a whole model in one form, for everything that computes with them.

The matrices of all actions lie below each other in CSR (`Rows`); one that several actions share is there once. Compiled
functions take such rows as they are. Products take them as one matrix, dense where much of it is not zero
(`Dynamics.matrix`). The states that follow an action and an observation are one matrix per action (`Dynamics.joint`).
Each form is made when it is first asked for.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.models.events import by_entry
from mdm.models.matrices import csr, is_compressed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models.events import Resolvent
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP

Indices: TypeAlias = npt.NDArray[np.intp]

_DENSE = 0.25
"""From this part of non-zeros on products with a dense matrix are faster."""


class Rows(NamedTuple):
    """Matrices of one width below each other in CSR, one for each action.

    Row r of action a's matrix is row ``first[a] + r``. The entries of a row are those from ``starts[row]`` up to
    ``starts[row + 1]``. Indices are unsigned: compiled code need not look for negative ones.

    Attributes:
        first: Where each action's rows begin; the same for actions that share a matrix.
        starts: Where each row's entries begin, and the end of the last.
        columns: The column of each entry.
        values: The entries.
    """

    first: npt.NDArray[np.int64]
    starts: npt.NDArray[np.uint64]
    columns: npt.NDArray[np.uint32]
    values: npt.NDArray[np.float64]

    def matrix(self, width: int) -> Matrix:
        """Return all rows as one CSR matrix of this width, which shares the entries."""
        kind = np.int32 if len(self.values) <= np.iinfo(np.int32).max else np.int64
        columns = self.columns.view(np.int32).astype(kind, copy=False)
        return csr((self.values, columns, self.starts.astype(kind)), (len(self.starts) - 1, width), copy=False)


def stacked(matrices: Sequence[Matrix]) -> Rows:
    """Return matrices, dense or CSR, one per action, as `Rows`; an object that several actions share is kept once."""
    kept, places = distinct(matrices)
    parts = [_compressed(matrix) for matrix in kept]
    heights = np.cumsum([0, *(part.shape[0] for part in parts)])
    starts = np.zeros(heights[-1] + 1, dtype=np.uint64)
    np.cumsum(np.concatenate([np.diff(part.indptr) for part in parts]), out=starts[1:], dtype=np.uint64)
    return Rows(
        heights[places].astype(np.int64),
        starts,
        np.concatenate([part.indices for part in parts]).astype(np.uint32, copy=False),
        np.concatenate([part.data for part in parts]),
    )


def once(matrices: Sequence[Matrix], make: Callable[[Matrix], Any]) -> list[Any]:
    """Return the result of a function of each matrix; it is called once for one that several actions share."""
    kept, places = distinct(matrices)
    made = [make(matrix) for matrix in kept]
    return [made[place] for place in places]


def distinct(matrices: Sequence[Matrix]) -> tuple[list[Matrix], list[int]]:
    """Return the different objects among matrices, and the place of each matrix among these."""
    places: dict[int, int] = {}
    for matrix in matrices:
        places.setdefault(id(matrix), len(places))
    kept = {places[id(matrix)]: matrix for matrix in matrices}
    return [kept[place] for place in range(len(kept))], [places[id(matrix)] for matrix in matrices]


class Joint(NamedTuple):
    """P(s', o | s, a) of one action: a row over s' for each pair of s and o that is possible, ordered by s, then o.

    Attributes:
        rows: CSR, pairs x S'.
        states: The s of each pair.
        observations: The o of each pair.
    """

    rows: Matrix
    states: Indices
    observations: Indices

    def only(self, which: npt.NDArray[np.bool_]) -> Joint:
        """Return some of the pairs, given as a mask over them."""
        return Joint(self.rows[np.flatnonzero(which)], self.states[which], self.observations[which])

    def summed(self) -> Matrix:
        """Return the sum over the observations, S x S', in CSR."""
        size = self.rows.shape[1]
        result = csr((self.rows.data, self.rows.indices, self.starts), (size, size))
        result.sum_duplicates()
        return result

    def side_by_side(self, num_observations: int) -> Matrix:
        """Return the matrices of the observations side by side, S x O S', in CSR: P(s', o) in column o S + s'."""
        size = self.rows.shape[1]
        columns = np.repeat(self.observations, np.diff(self.rows.indptr)) * size + self.rows.indices
        return csr((self.rows.data, columns, self.starts), (size, num_observations * size), copy=False)

    @property
    def starts(self) -> Indices:
        """Where the entries of each s begin, and the end of the last."""
        starts: Indices = self.rows.indptr[np.searchsorted(self.states, np.arange(self.rows.shape[1] + 1))]
        return starts


class Dynamics:
    """T, O and R of a model.

    Args:
        model: An MDP or a POMDP; factored ones are flattened.

    Example:
        >>> from mdm.problems import tiger
        >>> dynamics = Dynamics(tiger())
        >>> dynamics.q_values(dynamics.rewards.max(axis=1)).round(2).tolist()
        [[8.5, -90.5, 19.5], [8.5, 19.5, -90.5]]
    """

    def __init__(self, model: MDP) -> None:
        self.model: MDP = model.flatten()
        """The model as matrices."""
        self.discount = model.discount
        self.rewards: Vector = np.ascontiguousarray(self.model.rewards)
        """R(s, a): S x A."""
        self.num_states: int = len(self.rewards)
        self.num_actions: int = self.rewards.shape[1]
        self.num_observations = 0 if model.observation_space is None else len(model.observation_space)
        """How many observations there are; 0 of an MDP."""
        self.by_transition = model.event_observations
        """Whether observations are events: they depend on the state that a transition leaves, too."""
        self.matrices: list[Matrix] = [self.model.transition_matrix(action) for action in range(self.num_actions)]
        """T of each action, S x S', as the model has them."""

    @cached_property
    def transitions(self) -> Rows:
        """P(s' | s, a): a row over s' for each s."""
        return self.model.stacked.get("T") or stacked(self.matrices)

    @cached_property
    def observations(self) -> Rows:
        """P(o | a, s'): a row over o for each s'. Of events P(o | s, a, s'), for each entry of the action's T.

        Rows of events have one more column, for the rest, without any observation.
        """
        model = self._pomdp
        if model.events is None:
            return model.stacked.get("O") or stacked(self._told)
        return stacked([by_entry(model.events, a, matrix) for a, matrix in enumerate(self.matrices)])

    @property
    def _pomdp(self) -> POMDP:
        """The model as matrices, where it has observations."""
        assert self.model.pomdp is not None
        return self.model.pomdp

    @property
    def _told(self) -> list[Matrix]:
        model = self._pomdp
        return [model.observation_matrix(action) for action in range(self.num_actions)]

    @cached_property
    def transition_matrices(self) -> list[Matrix]:
        """T of each action in CSR: the model's own arrays where they are CSR."""
        return once(self.matrices, _compressed)

    @cached_property
    def observation_matrices(self) -> list[Matrix]:
        """P(o | a, s') of each action in CSR, S' x O, where observations are no events."""
        return once(self._told, _compressed)

    @cached_property
    def joint_matrices(self) -> list[list[Matrix]]:
        """P(s', o | s, a) of each action and observation in CSR, S x S'."""
        model = self._pomdp
        observations = range(self.num_observations)
        return [[_compressed(model.joint_matrix(a, o)) for o in observations] for a in range(self.num_actions)]

    @cached_property
    def resolvents(self) -> list[Resolvent | None]:
        """The resolvent of each action's steps without a detection (`POMDP.resolvent`); None where it has none."""
        model = self._pomdp
        return [model.resolvent(a) if model.waits_in(a) else None for a in range(self.num_actions)]

    @property
    def moves_by_joints(self) -> bool:
        """Whether beliefs move by P(s', o | s, a) alone: with events, and with false negatives."""
        return self.by_transition or self.model.false_negative is not None

    @cached_property
    def matrix(self) -> Matrix:
        """T of all actions as one matrix, with the rows of `transitions`: dense where much is not zero, else CSR."""
        kept, _ = distinct(self.matrices)
        entries = sum(matrix.nnz if is_compressed(matrix) else int(np.count_nonzero(matrix)) for matrix in kept)
        if entries > _DENSE * len(kept) * self.num_states**2:
            return np.concatenate([dense(matrix) for matrix in kept])
        return self.transitions.matrix(self.num_states)

    @property
    def is_dense(self) -> bool:
        """Whether `matrix` is dense."""
        return not is_compressed(self.matrix)

    @property
    def entries(self) -> int:
        """How many numbers a sweep over all states and actions reads."""
        if self.is_dense:
            return self.num_actions * self.num_states * self.num_states
        starts, first = self.transitions.starts, self.transitions.first
        lengths: list[int] = (starts[first + self.num_states] - starts[first]).tolist()
        return sum(lengths)

    @cached_property
    def places(self) -> Indices:
        """The row of each state and action in `matrix`: S x A."""
        _, places = distinct(self.matrices)
        rows: Indices = np.arange(self.num_states)[:, None] + self.num_states * np.array(places)
        return rows

    def after(self, values: Vector) -> Vector:
        """Return the expected value of the next state, for each state and action: S x A, of S numbers."""
        product = self.matrix @ values
        if len(product) == self.rewards.size:
            return np.ascontiguousarray(product.reshape(self.num_actions, self.num_states).T)
        return np.asarray(product[self.places])

    def q_values(self, values: Vector) -> Vector:
        """Return R(s, a) + discount * the expected value of the next state: S x A, of S numbers."""
        table = self.after(values)
        table *= self.discount
        table += self.rewards
        return table

    def under(self, policy: Indices) -> tuple[Matrix, Vector]:
        """Return the transitions (S x S') and rewards (S) of a policy, given as an action for each state."""
        states = np.arange(self.num_states)
        return self.matrix[self.places[states, policy]], self.rewards[states, policy]

    @cached_property
    def likelihoods(self) -> list[Vector]:
        """P(o | a, s') of each action, dense, O x S', where observations are no events."""
        return once(self._told, lambda matrix: np.ascontiguousarray(dense(matrix).T))

    @cached_property
    def _joints(self) -> list[Matrix]:
        """P(s', o | s, a) of each action, S x O S', in CSR."""
        count, joints = self.num_observations, map(self.joint, range(self.num_actions))
        return [joint.only(joint.observations < count).side_by_side(count) for joint in joints]

    def step(self, action: int, beliefs: Vector) -> Vector:
        """Return P(o, s') after an action, for each of n distributions over states (n x S): n x O x S'."""
        if self.by_transition:
            return np.asarray(beliefs @ self._joints[action]).reshape(len(beliefs), -1, self.num_states)
        after: Vector = np.asarray(beliefs @ self.matrices[action])
        return after[:, None, :] * self.likelihoods[action]

    def joint(self, action: int) -> Joint:
        """Return P(s', o | s, a) of an action.

        The part that events leave to no observation at all is one more observation, the last.
        """
        before, after, chances = _entries(self.transitions, self.transitions.first[action], self.num_states)
        first = self.observations.first[action]
        seen = first + (np.arange(len(after)) if self.by_transition else after)
        of, symbols, likelihoods = _gathered(self.observations, seen)
        keys = before[of] * (self.num_observations + 1) + symbols
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        begins = np.flatnonzero(np.diff(keys, prepend=-1))
        states, observations = np.divmod(keys[begins], self.num_observations + 1)
        starts = np.append(begins, len(keys))
        parts = (chances[of] * likelihoods)[order], after[of][order], starts
        return Joint(csr(parts, (len(begins), self.num_states), copy=False), states, observations)


def dense(matrix: Matrix) -> Vector:
    """Return a matrix as an array."""
    return np.asarray(matrix.toarray() if is_compressed(matrix) else matrix)


def _compressed(matrix: Matrix) -> Matrix:
    return matrix if is_compressed(matrix) else csr(matrix)


def _entries(rows: Rows, first: int, count: int) -> tuple[Indices, Indices, Vector]:
    """Return the entries of some rows in their order: each one's row, counted from the first, column and value."""
    starts = rows.starts[first : first + count + 1].astype(np.intp)
    part = slice(starts[0], starts[-1])
    return np.repeat(np.arange(count), np.diff(starts)), rows.columns[part].astype(np.intp), rows.values[part]


def _gathered(rows: Rows, which: Indices) -> tuple[Indices, Indices, Vector]:
    """Return the entries of rows in any order: to which of these rows each belongs, its column and value."""
    starts = rows.starts.astype(np.intp)
    begins, lengths = starts[which], np.diff(starts)[which]
    of = np.repeat(np.arange(len(which)), lengths)
    at = np.arange(len(of)) + np.repeat(begins - (np.cumsum(lengths) - lengths), lengths)
    return of, rows.columns[at].astype(np.intp), rows.values[at]
