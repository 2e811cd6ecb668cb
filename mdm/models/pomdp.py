"""Partially observable Markov decision processes, for one agent or a team (MPOMDP), as plain data."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.availability import check_known
from mdm.models.events import (
    DenseEvents,
    EventObservations,
    Resolvent,
    TransitionEvents,
    event_observations as checked_events,
    leading_to_detection,
)
from mdm.models.matrices import (
    Matrix,
    Vector,
    csr,
    held_bytes,
    is_compressed,
    num_entries,
    numbers,
    stochastic_matrices,
)
from mdm.models.mdp import MDP, as_space, matrix_row

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import Self

    import numpy.typing as npt

    from mdm.models.availability import Available
    from mdm.models.functions import Odds, Values
    from mdm.models.rewards import OutcomeRewards
    from mdm.models.space import Space, Symbol

_INVERSES = 4_000_000
"""The largest total size of the actions' inverses for which resolvents of CSR matrices are dense."""


class POMDP(MDP):
    """A partially observable Markov decision process: an `MDP` whose state is known only by observations.

    Args:
        transitions: As for `MDP`.
        observations: P(o | a, s'): an A x S' x O array, or one S' x O matrix per action, dense or sparse. For event
            observations P(o | s, a, s'): an A x O x S x S' array, one S x S' matrix per action and observation, or
            another model's ``events``.
        rewards: As for `MDP`; or R(a, s, s', o), A x S x S' x O.
        observation_names: Names of the observations, their number, or a `Space` with a factor per agent.
        event_observations: Whether ``observations`` are those of events, P(o | s, a, s').

    The other arguments are those of `MDP`. The last observation has to tell which actions are available.

    Raises:
        ModelError: If shapes do not fit or numbers are not probabilities.

    Example::

        stuck = [[1, 0], [0, 1]]
        noisy, blind = [[0.9, 0.1], [0.1, 0.9]], [[0.5, 0.5], [0.5, 0.5]]
        model = mdm.models.POMDP(
            [stuck, stuck],
            [noisy, blind],
            rewards=[[-1, 10], [-1, -10]],
            discount=0.9,
            states=["good", "bad"],
            actions=["look", "take"],
            observation_names=["shiny", "dull"],
        )
        mdm.BeliefTracker(model).update("look", "shiny")  # 0.5
    """

    kind: Literal["MDP", "POMDP"] = "POMDP"
    observation_space: Space
    _false_negative: int | None = None
    _tells_all: bool = False
    _discounts_waits: bool = False
    _resolvents: dict[tuple[int, float], Resolvent]

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
        available: Available | None = None,
        sparse: bool | None = None,
    ) -> None:
        self._set_dynamics(transitions, rewards, discount, states, actions, initial_belief, available, sparse)
        self._resolvents = {}
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
        check_known(self)

    @classmethod
    def from_functions(  # type: ignore[override]
        cls,
        states: Values | None,
        actions: Values,
        observations: Values,
        *,
        transition: Callable[..., Odds],
        observation: Callable[..., Odds],
        reward: Callable[..., float],
        discount: float,
        initial: Odds | None = None,
        available: Callable[..., bool] | None = None,
    ) -> POMDP:
        """Return the model that functions describe; the other arguments are those of `MDP.from_functions`.

        Args:
            states: As there.
            actions: As there.
            observations: Any hashable values; a dict with those of each agent by its name.
            transition: As there.
            observation: ``observation(a, s2)``, the distribution of what is seen in the next state, or
                ``observation(s, a, s2)``, of events.
            reward: As there.
            discount: As there.
            initial: As there.
            available: As there.

        Example::

            model = mdm.POMDP.from_functions(
                ["left", "right"],
                ["listen"],
                ["growl left", "growl right"],
                transition=lambda s, a: s,
                observation=lambda a, s2: {f"growl {s2}": 0.85, f"growl {'left' if s2 == 'right' else 'right'}": 0.15},
                reward=lambda s, a: -1,
                discount=0.95,
            )
        """
        from mdm.models.functions import described  # noqa: PLC0415 - for who describes one so

        seen = observations, observation
        return POMDP(**described(states, actions, transition, reward, initial, available, seen), discount=discount)

    @property
    def pomdp(self) -> POMDP:
        """The model itself."""
        return self

    @property
    def events(self) -> EventObservations | None:
        """The event observations; None if observations depend on the next state alone."""
        return self._events

    @property
    def event_observations(self) -> bool:
        """Whether observations are those of events, P(o | s, a, s')."""
        return self._events is not None

    def observation_matrix(self, action: Symbol) -> Matrix:
        """Return P(o | a, s') as an S' x O matrix, read-only.

        Raises:
            ModelError: If the observations are events, which depend on the state before as well.
        """
        if self.event_observations:
            raise ModelError("the observations of this model are events, P(o | s, a, s'): ask for event_matrix(a, o)")
        return self._observations[self.action_space.index(action)]

    def event_matrix(self, action: Symbol, observation: Symbol) -> Matrix:
        """Return P(o | s, a, s') of event observations as an S x S' matrix, read-only.

        Where T(s, a, s') is 0 it has no meaning; in CSR it is 0 there.

        Raises:
            ModelError: If the observations are not events.
        """
        if self._events is None:
            raise ModelError(
                "the observations of this model are of states, P(o | a, s'): ask for observation_matrix(a)"
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
        """Return P(o | a, s'), by names or indices: the row over o (O numbers), or a single entry.

        Args:
            action: The action.
            next_state: The state after it.
            observation: The entry; None for the row.
            state: The state before it, for event observations.

        Raises:
            ModelError: If event observations lack the state before.
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
        """The index of the false negative among the observations; None if every event is detected."""
        return self._false_negative

    def with_false_negatives(self, symbol: Symbol | None) -> Self:
        """Return the same model with one observation as its false negative: an undetected event.

        Any number of false negatives may precede a detected event. Trackers, solvers, simulations and evaluations
        account for them: after a false negative the action goes on, without a decision. So it does where events leave
        something to no observation. Who is told of each step (`step_by_step`) has no false negatives: there the symbol
        is an observation like any other.

        Args:
            symbol: The observation, by name or index; None for no false negatives.

        Raises:
            ModelError: If there is no such observation, or it is the only one.
        """
        index = None if symbol is None else self.observation_space.index(symbol)
        if index is not None and len(self.observation_space) == 1:
            name = self.observation_space.names[0]
            raise ModelError(
                f"the model's only observation {name!r} cannot be its false negative: no event would ever be detected"
            )
        other = self._with_resolvents(None if self._tells_all else index, {})
        check_known(other)
        return other

    def _with_resolvents(self, false_negative: int | None, resolvents: dict[tuple[int, float], Resolvent]) -> Self:
        other = copy.copy(self)
        vars(other).update(_false_negative=false_negative, _resolvents=resolvents)
        return other

    def step_by_step(self) -> Self:
        """Return the same model for an agent that is told of each time step, and of those without an observation, too.

        So is one that decides at a fixed rate. What is observed is then of the last step, and no unseen steps precede
        it; the model's false negative is an observation like any other.
        """
        other = self._with_resolvents(None, {})
        other._tells_all = True  # noqa: SLF001 - a model of the same kind
        return other

    def with_discounted_waits(self) -> Self:
        """Return the same model with beliefs in which steps without a detection are discounted, as in its values.

        Who does not know how long it took to detect something has less to gain where it took long. An agent that
        chooses by such beliefs among the vectors of a solver earns at least their bound. Other beliefs are the
        probabilities of the states; they promise that only where waits are short, or as long in all states. Files do
        not keep the difference.
        """
        other = copy.copy(self)
        other._discounts_waits = True  # noqa: SLF001 - a model of the same kind
        return other

    @property
    def waits(self) -> bool:
        """Whether some action may go on without a detection, as `waits_in` has it."""
        return any(self.waits_in(action) for action in range(len(self.action_space)))

    def waits_in(self, action: Symbol) -> bool:
        """Return whether an action may go on without a detection.

        It may if the model has a false negative, or if events leave something to no observation.
        """
        return self._false_negative is not None or self._rest(self.action_space.index(action)) is not None

    def _rest(self, action: int) -> Matrix | None:
        """Return the part without any observation: P(s', nothing | s, a); None where there is no such step."""
        if self._tells_all or not self.event_observations:
            return None
        assert self.events is not None
        return self.events.rests[action]

    @property
    def waiting(self) -> list[str]:
        """How its beliefs differ from those of a model with the same numbers: nothing, as a rule."""
        kinds = {"step by step": self._tells_all and self.event_observations, "discounted waits": self._discounts_waits}
        return [name for name, holds in kinds.items() if holds]

    def _of_this_kind(self, other: POMDP) -> POMDP:
        """Let another model, which nobody else holds, wait as this one does."""
        other._tells_all, other._discounts_waits = self._tells_all, self._discounts_waits
        return other

    def resolvent(self, action: Symbol) -> Resolvent:
        """Return the resolvent (I - N)^-1 of an action: the steps without a detection before a detected event.

        It is computed once, on first use, and shared by copies of the model. With discounted waits N is discounted.

        Raises:
            ModelError: If the action does not wait: every event is detected.
        """
        a = self.action_space.index(action)
        if not self.waits_in(a):
            raise ModelError("the model has no false negatives: declare them by with_false_negatives(observation)")
        key = a, self.discount if self._discounts_waits else 1.0
        if key not in self._resolvents:
            rest, missed = self._rest(a), self._false_negative
            joint = rest if missed is None else self.joint_matrix(a, missed)
            joint = leading_to_detection(joint if rest is None or missed is None else joint + rest)
            if is_compressed(joint) and len(self.action_space) * len(self.state_space) ** 2 <= _INVERSES:
                joint = joint.toarray()
            self._resolvents[key] = Resolvent(joint if key[1] == 1 else key[1] * joint)
        return self._resolvents[key]

    def flatten(self) -> POMDP:
        """Return the model as matrices; a flat model returns itself."""
        return self

    def revealed(self) -> POMDP:
        """Return the `MixedPOMDP` in which fully observed state factors are part of the observations.

        A model without fully observed factors returns itself.

        Raises:
            ModelError: If factors are fully observed, and observations are events or one is a false negative.
        """
        return self

    @property
    def seen_in(self) -> npt.NDArray[np.intp]:
        """For each state the joint index of the state factors that the observations include; 0 where there are none."""
        return np.zeros(len(self.state_space), dtype=np.intp)

    @property
    def layout(self) -> npt.NDArray[np.intp]:
        """The index of each state: an X x Y array, observed x hidden."""
        return np.arange(len(self.state_space))[None, :]

    def _observations_size(self, transitions: Sequence[Matrix]) -> tuple[int, int]:
        if self.events is None:
            matrices = [self.observation_matrix(action) for action in range(len(self.action_space))]
            return held_bytes(matrices), num_entries(matrices[0])
        count = len(self.observation_space)
        kinds = list({id(matrix): matrix for matrix in transitions}.values())
        return held_bytes(kinds) * count, num_entries(transitions[0]) * count

    def belief_at_start(self, state: int) -> Vector:
        """Return the belief before the first action of an episode that begins in a state."""
        return self.initial_belief

    def marginalize(self, factor: str) -> POMDP:
        """Return the model without a state factor on whose present value nothing else depends.

        Observations may depend on the factor's next value f': they are averaged by P(f' | x, a, y). The result depends
        on the transition from x to y, so observations become events, unless they turn out not to depend on x.

        Raises:
            ModelError: If there is no such factor, it is the only one, or transitions or rewards depend on it.
        """
        from mdm.models.factored.marginalisation import marginalize  # noqa: PLC0415 - it makes models of this kind

        result = marginalize(self, factor)
        assert isinstance(result, POMDP)
        return self._of_this_kind(result.with_false_negatives(self.false_negative).timed_as(self))

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
