"""Partially observable Markov decision processes, for one agent or a team (MPOMDP), as plain data."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.compressed import csr, is_compressed
from mdm.models.detection import Resolvent, leading_to_detection
from mdm.models.events import (
    DenseEvents,
    EventObservations,
    TransitionEvents,
    event_observations as checked_events,
)
from mdm.models.matrices import Matrix, Vector, numbers, stochastic_matrices
from mdm.models.mdp import MDP, as_space, matrix_row

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Self

    import numpy.typing as npt

    from mdm.models.rewards import OutcomeRewards
    from mdm.models.space import Space, Symbol

__all__ = ["POMDP"]

_INVERSES = 4_000_000
"""So many numbers may be held as the inverse matrices of all actions' resolvents; larger CSR ones are factorised."""


class POMDP(MDP):
    """A partially observable Markov decision process: an `MDP` whose state shows in observations alone.

    Args:
        transitions: As for `MDP`.
        observations: P(o | a, s'): an A x S' x O array, or one S' x O matrix per action, dense or sparse. For event
            observations P(o | s, a, s'): an A x O x S x S' array, or one S x S' matrix per action and observation, or
            what another model has of them.
        rewards: As for `MDP`; or R(a, s, s', o), A x S x S' x O.
        observation_names: Names of the observations, how many there are, or a `Space` with a factor per agent.
        event_observations: Whether observations tell of transitions, P(o | s, a, s').

    The other arguments are those of `MDP`.

    Raises:
        ModelError: If shapes do not fit or numbers are no probabilities.
    """

    kind: Literal["MDP", "POMDP"] = "POMDP"
    _false_negative: int | None = None
    _resolvents: dict[int, Resolvent]

    def __init__(
        self,
        transitions: Sequence[Any] | npt.NDArray[np.float64],
        observations: Sequence[Any] | npt.NDArray[np.float64] | DenseEvents | TransitionEvents,
        rewards: npt.ArrayLike,
        *,
        discount: float,
        states: Space | Iterable[str] | int | None = None,
        actions: Space | Iterable[str] | int | None = None,
        observation_names: Space | Iterable[str] | int | None = None,
        initial_belief: npt.ArrayLike | None = None,
        event_observations: bool = False,
        outcome_rewards: OutcomeRewards | None = None,
        sparse: bool | None = None,
    ) -> None:
        self._set_dynamics(transitions, rewards, discount, states, actions, initial_belief, sparse)
        self._events: EventObservations | None = None
        self._observations: tuple[Matrix, ...] = ()
        if isinstance(observations, (DenseEvents, TransitionEvents)):
            self._events = observations
        elif event_observations:
            self._events = checked_events(
                self._transitions, list(observations), actions=self.action_space, states=self.state_space
            )
        else:
            self._observations = stochastic_matrices(
                observations,
                what="O",
                actions=self.action_space,
                rows=self.state_space,
                columns=_width(observations),
                sparse_=sparse,
            )
        count = self._events.num_observations if self._events else _width(observations)
        self.observation_space = as_space("agent", observation_names, count)
        if len(self.observation_space) != count:
            raise ModelError(
                f"O is over {count} observations, but {len(self.observation_space)} names of observations are given"
            )
        self._set_rewards(rewards, outcome_rewards)

    @property
    def events(self) -> EventObservations | None:
        """How observations tell of transitions; None where they tell of states."""
        return self._events

    @property
    def event_observations(self) -> bool:
        """Whether observations tell of transitions, P(o | s, a, s'), rather than of states."""
        return self._events is not None

    def observation_matrix(self, action: Symbol) -> Matrix:
        """Return P(o | a, s') as an S' x O matrix, read-only.

        Raises:
            ModelError: If the observations are events: they depend on the state that a transition leaves, too.
        """
        if self.event_observations:
            raise ModelError("the observations of this model are events, P(o | s, a, s'): ask for event_matrix(a, o)")
        return self._observations[self.action_space.index(action)]

    def event_matrix(self, action: Symbol, observation: Symbol) -> Matrix:
        """Return P(o | s, a, s') of event observations as an S x S' matrix, read-only.

        Where T(s, a, s') is 0 it has no meaning; in CSR it is 0 there.

        Raises:
            ModelError: If the observations are no events.
        """
        if self._events is None:
            raise ModelError(
                "the observations of this model tell of states, P(o | a, s'): ask for observation_matrix(a)"
            )
        return self._events.matrix(self.action_space.index(action), self.observation_space.index(observation))

    def joint_matrix(self, action: Symbol, observation: Symbol) -> Matrix:
        """Return P(s', o | s, a) as an S x S' matrix, for observations of either kind."""
        a, o = self.action_space.index(action), self.observation_space.index(observation)
        if self.event_observations:
            assert self._events is not None
            return self._events.joint(a, o)
        transition, matrix = self.transition_matrix(a), self.observation_matrix(a)
        if isinstance(transition, np.ndarray):
            column = matrix[:, o] if isinstance(matrix, np.ndarray) else matrix[:, [o]].toarray().ravel()
            return transition * column
        column = np.asarray(matrix[:, [o]].toarray()).ravel() if is_compressed(matrix) else matrix[:, o]
        joint = csr(
            (transition.data * column[transition.indices], transition.indices, transition.indptr), transition.shape
        )
        joint.eliminate_zeros()
        return joint

    def observation(
        self, action: Symbol, next_state: Symbol, observation: Symbol | None = None, *, state: Symbol | None = None
    ) -> Any:
        """Return P(o | a, s'), by names or indices: the row over o (O numbers), or one number.

        Args:
            action: The action.
            next_state: The state that it led to.
            observation: Asks for one number.
            state: The state before, which event observations depend on.

        Raises:
            ModelError: If the state before is missing and needed.
        """
        a, s = self.action_space.index(action), self.state_space.index(next_state)
        if not self.event_observations:
            row = matrix_row(self.observation_matrix(a), s)
        elif state is None:
            raise ModelError("the observations of this model are events: name the state before, too (state=)")
        else:
            row = self._event_row(a, self.state_space.index(state), s)
        return row if observation is None else float(row[self.observation_space.index(observation)])

    def _event_row(self, action: int, state: int, next_state: int) -> Vector:
        assert self._events is not None
        return self._events.row(action, state, next_state)

    def _chances(self, action: int, states: Any, next_states: Any) -> Vector:
        if self._events is not None:
            return np.stack([self._events.row(action, s, n) for s, n in zip(states, next_states, strict=True)])
        matrix = self._observations[action][next_states]
        return np.asarray(matrix.toarray()) if is_compressed(matrix) else matrix

    def _observation_index(self, observation: Symbol) -> int:
        return self.observation_space.index(observation)

    @property
    def false_negative(self) -> int | None:
        """The index of the observation that is a false negative; None where every event is detected."""
        return self._false_negative

    def with_false_negatives(self, symbol: Symbol | None) -> Self:
        """Return the same model with an observation that is a false negative: an event that nobody detects.

        Any number of such events may precede each one that is observed. Trackers, solvers, simulations and evaluations
        take that into account: after a false negative the action goes on, and nothing is decided.

        Args:
            symbol: The observation, by name or index; None for none, as at first.

        Raises:
            ModelError: If there is no such observation, or no other.
        """
        index = None if symbol is None else self.observation_space.index(symbol)
        if index is not None and len(self.observation_space) == 1:
            name = self.observation_space.names[0]
            raise ModelError(
                f"the model's only observation {name!r} cannot be its false negative: no event is detected"
            )
        return self._with_resolvents(index, {})

    def _with_resolvents(self, false_negative: int | None, resolvents: dict[int, Resolvent]) -> Self:
        other = copy.copy(self)
        vars(other).update(_false_negative=false_negative, _resolvents=resolvents)
        return other

    def resolvent(self, action: Symbol) -> Resolvent:
        """Return (I - H_f)^-1 of an action: all the false negatives that may precede a detected event.

        It is made when it is first asked for, once for all copies of the model with other discounts.

        Raises:
            ModelError: If the model has no false negatives.
        """
        if self._false_negative is None:
            raise ModelError("the model has no false negatives: name the observation, with with_false_negatives(...)")
        a = self.action_space.index(action)
        if a not in self._resolvents:
            joint = leading_to_detection(self.joint_matrix(a, self._false_negative))
            if is_compressed(joint) and len(self.action_space) * len(self.state_space) ** 2 <= _INVERSES:
                joint = joint.toarray()
            self._resolvents[a] = Resolvent(joint)
        return self._resolvents[a]

    def flatten(self) -> POMDP:
        """Return the model as matrices: itself, where it is not factored."""
        return self

    def revealed(self) -> POMDP:
        """Return the model as its agent sees it, a `MixedPOMDP`, where factors of the state are fully observed.

        Any other model is returned as it is.

        Raises:
            ModelError: If factors are fully observed, and observations are events or one is a false negative.
        """
        return self

    def belief_at_start(self, state: int) -> Vector:  # noqa: ARG002 - a model that shows some of it needs it
        """Return the belief of an agent before its first action, in an episode that begins in some state."""
        return self.initial_belief

    def marginalize(self, factor: str) -> POMDP:
        """Return the model without a state factor, where nothing else depends on that factor's present value.

        What is observed may tell of the factor's value after the transition; it is weighed by P(f' | x, a, y), and then
        tells of the transition from x to y: the observations become events, unless they do not depend on x.

        Raises:
            ModelError: If there is no such factor, it is the only one, or transitions or rewards depend on it.
        """
        from mdm.models.factored.marginalisation import marginalize  # noqa: PLC0415 - it makes models of this kind

        result = marginalize(self, factor)
        assert isinstance(result, POMDP)
        return result.with_false_negatives(self.false_negative)

    def __repr__(self) -> str:
        text = f"{super().__repr__()[:-1]}, {len(self.observation_space)} observations"
        if self._false_negative is not None:
            text += f", false negative {self.observation_space.names[self._false_negative]!r}"
        return text + ">"


def _width(observations: Any) -> int:
    """Return O of observations P(o | a, s')."""
    first: Any = observations[0] if len(observations) else ()
    shape = first.shape if is_compressed(first) else numbers(first, "the first matrix of observations").shape
    if len(shape) != 2 or 0 in shape:
        raise ModelError("observations are an actions x states x observations array, or a matrix per action")
    return int(shape[1])
