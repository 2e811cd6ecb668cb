"""Event observations, P(o | s, a, s'): they depend on a transition rather than on the next state alone.

Rows of impossible transitions have no meaning, and need not sum to 1. Other rows may sum to less than 1: the rest is
the probability that nothing is observed (real models leave a few per cent open), in ``rests``. Rows are therefore kept
as given. A sum above 1 is an error; a validation that collects problems normalises it.

Any number of steps in which nothing is detected may precede an event that is. Let H_o(s, s') = T(s, a, s') P(o | s, a,
s'), and N be the steps without a detection: H_f of the false negative f, and the part that events leave to no
observation, T minus the sum of all H_o. Then the transition to the next detected event is one step of H_o after 0, 1,
2, ... steps of N. The powers of N add up to its resolvent (I - N)^-1 (J. V. Messias, M. T. J. Spaan and P. U. Lima,
*Asynchronous execution in multiagent POMDPs: reasoning over partially-observable events*, MSDM 2013), which is
factorised once per action.
"""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.models.matrices import (
    ROUNDING,
    TOLERANCE,
    Matrix,
    Vector,
    csr,
    csr_identity,
    is_compressed,
    numbers,
    read_only,
)
from mdm.models.validation import report

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.mdp import MDP
    from mdm.models.space import Space

_TOLD = 100
_CERTAIN = 1e-12
_ROUNDING = 1e-5
"""Rows may sum to so much less than 1 by rounding alone: files give six digits."""


class EventObservations(Protocol):
    """The observations of each action's transitions."""

    num_observations: int

    @property
    def rests(self) -> Sequence[Matrix | None]:
        """P(s', nothing is observed | s, a) of each action, S x S'; None where there is no such step."""
        ...

    def matrix(self, action: int, observation: int) -> Matrix:
        """Return P(o | s, a, s'), S x S'."""
        ...

    def joint(self, action: int, observation: int) -> Matrix:
        """Return P(s', o | s, a), S x S'."""
        ...

    def row(self, action: int, state: int, next_state: int) -> Vector:
        """Return P(o | s, a, s') for every o."""
        ...


class DenseEvents:
    """An O x S x S' array per action, kept as given.

    Args:
        transitions: T per action, dense.
        events: The arrays.
        actions: Names the actions.
        states: Names the states.

    Raises:
        ModelError: If, where T is not 0, a number is not a probability or a row sums to more than 1.
    """

    def __init__(
        self,
        transitions: Sequence[Vector],
        events: Sequence[Vector],
        *,
        actions: Space,
        states: Space,
    ) -> None:
        self.num_observations = len(events[0])
        self._transitions = tuple(transitions)
        kept = []
        least = 1.0
        for action, (transition, event) in enumerate(zip(transitions, events, strict=True)):
            if event.shape != (self.num_observations, *transition.shape):
                shape = "x".join(map(str, event.shape))
                raise ModelError(
                    f"O of action {actions.names[action]!r} is {shape}; it needs an S x S' matrix per observation"
                )
            possible = transition > 0
            rows = event[:, possible]
            sums = rows.sum(axis=0)
            least = min(least, _checked(rows.min(axis=0), sums, np.nonzero(possible), actions, states, action))
            divisors = np.ones(transition.shape)
            divisors[possible] = _divisors(sums)
            finite = np.isfinite(event)
            if not finite.all() or divisors.max() > 1:  # NaN and infinity spoil products with T even where T is 0
                event = np.where(finite, event, 0.0) / divisors  # noqa: PLW2901 - the same, put right
            kept.append(read_only(event))
        _warn(least)
        self.events = tuple(kept)
        """P(o | s, a, s') per action: O x S x S'."""

    @cached_property
    def rests(self) -> list[Matrix | None]:
        """P(s', nothing is observed | s, a) of each action, S x S'; None where there is no such step."""
        pairs = zip(self._transitions, self.events, strict=True)
        return [_rest(transition * _left(event.sum(axis=0))) for transition, event in pairs]

    def matrix(self, action: int, observation: int) -> Matrix:
        """Return P(o | s, a, s'), S x S', read-only; as given, if finite, where T is 0."""
        return self.events[action][observation]

    def joint(self, action: int, observation: int) -> Matrix:
        """Return P(s', o | s, a), S x S'."""
        return self._transitions[action] * self.events[action][observation]

    def row(self, action: int, state: int, next_state: int) -> Vector:
        """Return P(o | s, a, s') for every o."""
        row: Vector = self.events[action][:, state, next_state]
        return row


class TransitionEvents:
    """A row over the observations for each possible transition, that is, for each entry of T in CSR.

    Args:
        transitions: T per action, in CSR.
        events: Per action a transitions x O matrix in CSR, in the order of T's entries.
        actions: Names the actions.
        states: Names the states.

    Raises:
        ModelError: If a number is not a probability or a row sums to more than 1.
    """

    def __init__(
        self,
        transitions: Sequence[Matrix],
        events: Sequence[Matrix],
        *,
        actions: Space,
        states: Space,
    ) -> None:
        self.num_observations = int(events[0].shape[1])
        self._transitions = tuple(transitions)
        self.events: list[Matrix] = []
        """P(o | s, a, s') per action: T's entries x O, in CSC."""
        least = 1.0
        for action, (transition, event) in enumerate(zip(transitions, events, strict=True)):
            places = (np.repeat(np.arange(len(states)), np.diff(transition.indptr)), transition.indices)
            lowest = event.min(axis=1).toarray() if event.nnz else np.zeros(event.shape[0])
            sums = np.asarray(event.sum(axis=1))
            least = min(least, _checked(lowest.ravel(), sums.ravel(), places, actions, states, action))
            if (divisors := _divisors(sums.ravel())).max(initial=1) > 1:
                event = csr(event)  # noqa: PLW2901 - the same rows, normalised
                event.data /= np.repeat(divisors, np.diff(event.indptr))
            self.events.append(event.tocsc())
        _warn(least)

    @cached_property
    def rests(self) -> list[Matrix | None]:
        """P(s', nothing is observed | s, a) of each action, in CSR; None where there is no such step."""
        return [self._rest(action) for action in range(len(self.events))]

    def _rest(self, action: int) -> Matrix | None:
        transition = self._transitions[action]
        left = transition.data * _left(np.asarray(self.events[action].sum(axis=1)).ravel())
        steps = csr((left, transition.indices, transition.indptr), transition.shape)
        steps.eliminate_zeros()
        return _rest(steps)

    def matrix(self, action: int, observation: int) -> Matrix:
        """Return P(o | s, a, s'), S x S' in CSR; 0 where T is 0."""
        return self._like_transition(action, observation, joint=False)

    def joint(self, action: int, observation: int) -> Matrix:
        """Return P(s', o | s, a), S x S' in CSR."""
        return self._like_transition(action, observation, joint=True)

    def row(self, action: int, state: int, next_state: int) -> Vector:
        """Return P(o | s, a, s') for every o; zeros where T is 0."""
        transition = self._transitions[action]
        first, last = transition.indptr[state : state + 2]
        at = first + np.searchsorted(transition.indices[first:last], next_state)
        if at == last or transition.indices[at] != next_state:
            return np.zeros(self.num_observations)
        return np.asarray(self.events[action][[int(at)]].toarray()).ravel()

    def _like_transition(self, action: int, observation: int, *, joint: bool) -> Matrix:
        transition, event = self._transitions[action], self.events[action]
        filled = slice(event.indptr[observation], event.indptr[observation + 1])
        entries, values = event.indices[filled], event.data[filled]
        rows = np.searchsorted(transition.indptr, entries, side="right") - 1
        starts = np.concatenate(([0], np.cumsum(np.bincount(rows, minlength=transition.shape[0]))))
        data = values * transition.data[entries] if joint else values
        return csr((data, transition.indices[entries], starts), transition.shape)


def event_observations(
    transitions: Sequence[Matrix], given: Sequence[Any], *, actions: Space, states: Space
) -> EventObservations:
    """Return event observations from an S x S' matrix, dense or sparse, per action and observation.

    Raises:
        ModelError: If shapes do not fit or, where T is not 0, a number is not a probability or a row exceeds 1.
    """
    size = len(states)
    if len(given) != len(actions):
        raise ModelError(f"O is given for {len(given)} actions, but the model has {len(actions)}")
    widths = {len(matrices) for matrices in given}
    if len(widths) != 1 or 0 in widths:
        raise ModelError("event observations need an S x S' matrix for each observation, as many for every action")
    events = []
    for action, (transition, matrices) in enumerate(zip(transitions, given, strict=True)):
        name = f"O of action {actions.names[action]!r}"
        each: list[Any] = [matrix if is_compressed(matrix) else numbers(matrix, name) for matrix in matrices]
        if any(matrix.shape != (size, size) for matrix in each):
            raise ModelError(f"{name} needs a {size} x {size} matrix for every observation")
        if isinstance(transition, np.ndarray):
            events.append(np.stack([matrix.toarray() if is_compressed(matrix) else matrix for matrix in each]))
        else:
            rows = np.repeat(np.arange(size), np.diff(transition.indptr))
            columns = [np.asarray(csr(matrix)[rows, transition.indices]).ravel() for matrix in each]
            events.append(csr(np.stack(columns, axis=1)))
    kind = DenseEvents if isinstance(transitions[0], np.ndarray) else TransitionEvents
    return kind(transitions, events, actions=actions, states=states)


def _checked(least: Vector, sums: Vector, places: Any, actions: Space, states: Space, action: int) -> float:
    """Return the least sum of a row."""
    wrong = ~((least >= 0) & (sums <= 1 + TOLERANCE))
    for at in np.flatnonzero(wrong)[:_TOLD].tolist():
        state, next_state = (states.names[int(place[at])] for place in places)
        what = f"sum to {sums[at]:.6g}, more than 1" if least[at] >= 0 else "hold a number that is not a probability"
        problem = (
            f"O of action {actions.names[action]!r}: the observations of the transition from {state!r} to "
            f"{next_state!r} {what}"
        )
        if not report(problem, is_sum=bool(least[at] >= 0)):
            raise ModelError(problem)
    return float(sums.min()) if sums.size else 1.0


def _divisors(sums: Vector) -> Vector:
    """Return the divisors of rows: 1, or a sum above 1, which was reported before."""
    return np.where(sums > 1 + TOLERANCE, sums, 1.0)


def _left(sums: Vector) -> Vector:
    """Return the rest of sums to 1, without rounding."""
    left = 1 - sums
    return np.where(left > ROUNDING, left, 0.0)


def _rest(steps: Matrix) -> Matrix | None:
    return None if is_rounding(steps) else steps


def _warn(least: float) -> None:
    if least < 1 - TOLERANCE:
        text = f"O of some transitions sums to as little as {least:.6g}; the rest counts as no observation"
        warnings.warn(text, ModelWarning, stacklevel=5)


def by_entry(events: EventObservations, action: int, transition: Matrix) -> Matrix:
    """Return P(o | s, a, s') for each entry of T, in their order, as CSR.

    An additional last column is the probability of no observation.
    """
    if isinstance(events, TransitionEvents):
        told = csr(events.events[action])
    else:
        assert isinstance(events, DenseEvents)
        told = csr(events.events[action][:, *np.nonzero(transition)].T)
    rest = _left(np.asarray(told.sum(axis=1)).ravel())
    from scipy.sparse import hstack  # noqa: PLC0415 - slow to import

    result = csr(hstack([told, csr(rest[:, None])]))
    result.eliminate_zeros()
    result.sort_indices()
    return result


class Resolvent:
    """The resolvent (I - H)^-1 of a matrix H with row sums of at most 1: the sum of its powers from 0 on.

    A dense matrix is inverted, a CSR matrix factorised.

    Args:
        steps: H, S x S', dense or CSR.

    Raises:
        numpy.linalg.LinAlgError: If I - H, dense, has no inverse.
        RuntimeError: If I - H, CSR, has none.
    """

    def __init__(self, steps: Matrix) -> None:
        self._steps = steps
        self._inverse: Vector | None = None
        self._factors: Any = None
        # The transpose has no negative column sum, so it is factorised without row exchanges. Every entry is then a
        # sum of positive numbers, and exactly 0 between unconnected states.
        if not is_compressed(steps):
            self._inverse = np.linalg.inv((np.eye(steps.shape[0]) - steps).T).T
            return
        from scipy.sparse.linalg import splu  # noqa: PLC0415 - slow to import

        self._factors = splu((csr_identity(steps.shape[0]) - steps).T.tocsc())

    def weights(self, rows: Matrix) -> Matrix:
        """Return rows of weights times the resolvent, in the kind given: S or n x S numbers, dense or CSR."""
        if self._inverse is not None:
            return rows @ self._inverse
        if is_compressed(rows):
            return csr(self.weights(rows.toarray()))
        if rows.ndim == 1:
            return np.asarray(self._factors.solve(rows))
        return np.ascontiguousarray(self._factors.solve(np.asarray(rows.T, order="F")).T)

    def values(self, columns: Vector) -> Vector:
        """Return the resolvent times columns of values: S or S x n numbers, dense."""
        if self._inverse is not None:
            return np.asarray(self._inverse @ columns)
        return np.asarray(self._factors.solve(columns, trans="T"))

    def __reduce__(self) -> tuple[type[Resolvent], tuple[Matrix]]:
        """Support copies: factors of a CSR matrix cannot be copied, and are made again."""
        return Resolvent, (self._steps,)


def is_rounding(steps: Matrix) -> bool:
    """Whether steps without a detection, S x S', are nothing but rounding."""
    return bool(np.asarray(steps.sum(axis=1)).max() <= _ROUNDING)


def leading_to_detection(joint: Matrix) -> Matrix:
    """Return steps without a detection, without the rows of states from which no event is ever detected.

    They contribute nothing to detected events, and would make I - N singular.

    Args:
        joint: P(s', nothing is detected | s, a) of an action, S x S', dense or CSR.
    """
    leads = np.asarray(joint.sum(axis=1)).ravel() < 1 - _CERTAIN
    while True:
        wider = leads | (np.asarray(joint @ leads.astype(np.float64)) > 0)
        if (wider == leads).all():
            break
        leads = wider
    if not is_compressed(joint):
        return joint * leads[:, None]
    kept = csr((joint.data * np.repeat(leads, np.diff(joint.indptr)), joint.indices, joint.indptr), joint.shape)
    kept.eliminate_zeros()
    return kept


def check_no_false_negatives(model: MDP, solver: str) -> None:
    """Refuse a model with false negatives, on behalf of a solver that does not support them.

    Raises:
        ModelError: If the model has any.
    """
    if model.false_negative is not None:
        raise ModelError(
            f"{solver} does not support false negatives: solve the model with sarsop or perseus, or without them "
            f"(model.with_false_negatives(None))"
        )
