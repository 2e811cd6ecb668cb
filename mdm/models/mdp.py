"""Markov decision processes, for one agent or a team (MMDP), as plain data."""

from __future__ import annotations

import copy
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar, overload

import numpy as np

from mdm.checks import is_number
from mdm.errors import ModelError
from mdm.models.availability import availability, standing_in
from mdm.models.matrices import (
    Matrix,
    MatrixSize,
    Vector,
    distribution,
    held_bytes,
    is_compressed,
    num_entries,
    read_only,
    stochastic_matrices,
)
from mdm.models.rewards import OutcomeRewards, RewardArray, check_finite, expected_rewards, reward_numbers
from mdm.models.space import Space, Symbol
from mdm.models.units import Unit, checked_unit
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from typing import Self

    import numpy.typing as npt

    from mdm.models.availability import Available, Mask
    from mdm.models.factored.two_slice import TwoSliceNetwork
    from mdm.models.functions import Odds, Values
    from mdm.models.pomdp import POMDP

_Flat = TypeVar("_Flat", bound="MDP")


class Keeper(Protocol):
    """Keeps the matrices of factored models, for more than one process."""

    def __call__(self, model: MDP, make: Callable[[], _Flat]) -> _Flat:
        """Return a model's matrices; they are made where nobody has them yet."""
        ...


class MDP:
    """A Markov decision process: states, actions, transition probabilities, expected rewards.

    Args:
        transitions: P(s' | s, a): an A x S x S array, or one S x S matrix per action, dense or sparse.
        rewards: The immediate reward: R(s) (S numbers), R(s, a) (S x A) or R(a, s, s') (A x S x S). `reward` answers
            for single outcomes of the last form.
        discount: In (0, 1], of a step; see `with_discount` for one of a second.
        states: Names, a number, or a `Space`; by default numbers from 0.
        actions: The same; a `Space` with one factor per agent makes a team.
        initial_belief: The distribution of the first state (S numbers); uniform by default.
        outcome_rewards: The rewards of single outcomes, if ``rewards`` is their expectation.
        available: Which actions are available in which states: an S x A array of booleans, or a function of the names
            of a state and an action; by default all. The transitions and rewards of others count for nothing.
        sparse: Force CSR or dense matrices; None chooses by size and density.

    Raises:
        ModelError: If shapes do not fit, numbers are not probabilities, or a state has no available action.

    Example::

        stay, go = [[1, 0], [0, 1]], [[0.2, 0.8], [0, 1]]
        rewards = [[0, -1], [5, 4]]  # of stay and go at home, and at work
        model = mdm.models.MDP([stay, go], rewards, discount=0.9, states=["home", "work"], actions=["stay", "go"])
        model.transition("go", "home", "work")  # 0.8
        mdm.solve(model).policy.action(0)  # 1
    """

    kind: Literal["MDP", "POMDP"] = "MDP"
    available: Mask | None = None
    """For each state and action whether it is available, S x A, read-only; None where all are."""
    observation_space: Space | None = None
    """The observations; None in an MDP."""
    discount_of: Unit = "step"
    """The time of the discount: ``"step"``, the seconds of a step, or ``"second"``, for actions that take time."""
    sparse: bool | None = None
    """Whether the matrices of a factored model are CSR or dense, where that is forced; else None."""
    network: TwoSliceNetwork | None = None
    """The network of a factored model; None for one that is its matrices."""
    observed: tuple[int, ...] = ()
    """The indices of the state factors that the observations include; see `MixedPOMDP`."""
    visits: Vector | None = None
    """Of an estimated model, how many decisions each row of T rests on, S x A; None where nothing was estimated."""
    _keeper: Keeper | None = None
    is_sparing: bool = False
    """Whether memory counts for more than microseconds; see `sparingly`."""
    stays_factored: bool = False
    """Whether beliefs and rewards are computed on factors, and no matrices are made for them."""
    stacked: Mapping[str, Any] = MappingProxyType({})
    """Mapped from a file: ``R``, and where they are sparse ``T`` and ``O`` as `Rows` of all actions."""

    def __init__(
        self,
        transitions: Sequence[Any] | npt.NDArray[np.float64],
        rewards: npt.ArrayLike,
        *,
        discount: float,
        states: Space | Iterable[str] | int | None = None,
        actions: Space | Iterable[str] | int | None = None,
        initial_belief: npt.ArrayLike | None = None,
        outcome_rewards: OutcomeRewards | None = None,
        available: Available | None = None,
        sparse: bool | None = None,
    ) -> None:
        self._set_dynamics(transitions, rewards, discount, states, actions, initial_belief, available, sparse)
        self._set_rewards(rewards, outcome_rewards)

    @classmethod
    def from_functions(
        cls,
        states: Values | None,
        actions: Values,
        *,
        transition: Callable[..., Odds],
        reward: Callable[..., float],
        discount: float,
        initial: Odds | None = None,
        available: Callable[..., bool] | None = None,
    ) -> MDP:
        """Return the model that functions describe, each of which is called once for each state and action.

        A distribution is a dict from values to probabilities, a list of pairs of value and probability (where a value
        may come twice), or the value that is certain; a value of the model is always taken as itself.

        Args:
            states: Any hashable values; a dict with the values of each factor by its name, whose states are named
                tuples; or None for those that ``initial`` leads to.
            actions: The same; a factor is an agent's. A value is named by ``str``, a tuple by its parts with commas.
            transition: ``transition(s, a)``, the distribution of the next state.
            reward: ``reward(s, a)`` or ``reward(s, a, s2)``, the immediate reward; the second is asked for
                transitions that there are.
            discount: In (0, 1], of a step.
            initial: The distribution of the first state; by default uniform.
            available: ``available(s, a)``, whether an action is available in a state; by default all are.

        Raises:
            ModelError: If a function returns no distribution or no number, or ``initial`` is missing: names state and
                action.

        Example::

            def drift(position, step):
                return [(min(position + step, 3), 0.9), (position, 0.1)]


            model = mdm.MDP.from_functions(
                range(4), [0, 1], transition=drift, reward=lambda s, a: float(s == 3), discount=0.9, initial=0
            )
            mdm.solve(model).policy.action(0)  # 1
        """
        from mdm.models.functions import described  # noqa: PLC0415 - for who describes one so

        return MDP(**described(states, actions, transition, reward, initial, available), discount=discount)

    @classmethod
    def from_arrays(cls, *arrays: Any, order: Literal["ASS", "SAS"] = "ASS", **options: Any) -> Self:
        """Return the model of some arrays, whose axes are in one order or the other.

        Args:
            arrays: Transitions and rewards; of a `POMDP` transitions, observations and rewards.
            order: Of the first axes of arrays of three or four: ``ASS``, actions first, as in the class itself, or
                ``SAS``, states first. R(s, a) is S x A in both, and a sequence of matrices has one for each action.
            options: The other arguments of the class.

        Raises:
            ModelError: If there is no such order, or it does not fit events, whose order is one alone.

        Example::

            mdm.MDP.from_arrays([[[0.9, 0.1], [0, 1]], [[0, 1], [0, 1]]], [0, 1], order="SAS", discount=0.9)
        """
        if order not in {"ASS", "SAS"}:
            raise ModelError(f"the order of axes is 'ASS' (actions first) or 'SAS' (states first), not {order!r}")
        if order == "ASS":
            return cls(*arrays, **options)
        if options.get("event_observations"):
            raise ModelError("observations of events are actions x observations x states x states: order='ASS'")
        return cls(*[array if _is_matrices(array) else _actions_first(array) for array in arrays], **options)

    def _set_dynamics(
        self,
        transitions: Sequence[Any] | npt.NDArray[np.float64],
        rewards: npt.ArrayLike,
        discount: float,
        states: Space | Iterable[str] | int | None,
        actions: Space | Iterable[str] | int | None,
        initial_belief: npt.ArrayLike | None,
        available: Available | None,
        sparse: bool | None,
    ) -> None:
        shape = reward_numbers(rewards, len(transitions)).shape
        num_states, num_actions = shape if len(shape) == 2 else (shape[1], shape[0])
        self.state_space = as_space("state", states, num_states)
        self.action_space = as_space("agent", actions, num_actions)
        if (num_states, num_actions) != (len(self.state_space), len(self.action_space)):
            raise ModelError(
                f"the rewards are for {num_states} states and {num_actions} actions, but there are "
                f"{len(self.state_space)} and {len(self.action_space)}"
            )
        self.discount = checked_discount(discount)
        self.available = availability(available, self.state_space, self.action_space)
        self._transitions = stochastic_matrices(
            transitions if self.available is None else standing_in(transitions, self.available),
            what="T",
            actions=self.action_space,
            rows=self.state_space,
            columns=num_states,
            sparse_=sparse,
        )
        self._initial_belief = distribution(
            np.full(num_states, 1 / num_states) if initial_belief is None else initial_belief,
            what="the initial belief",
            size=num_states,
        )

    def _set_rewards(self, rewards: npt.ArrayLike, outcome_rewards: OutcomeRewards | None) -> None:
        given = reward_numbers(rewards, len(self.action_space))
        if self.available is not None:
            given = standing_in(given, self.available)
        self.outcome_rewards = outcome_rewards if given.ndim == 2 else RewardArray(given)
        """The rewards of single outcomes, if there are any; else None."""
        expected = given if given.ndim == 2 else expected_rewards(given, self._transitions, self._chances)
        check_finite(expected, self.state_space, self.action_space)
        self._rewards: Vector = read_only(expected)

    def _chances(self, action: int, states: Any, next_states: Any) -> Vector:
        """Return P(o | s, a, s') for some transitions, a row for each."""
        raise ModelError("rewards of observations need a POMDP")

    @property
    def rewards(self) -> Vector:
        """The expected immediate reward R(s, a): S x A, read-only."""
        return self._rewards

    @property
    def initial_belief(self) -> Vector:
        """The distribution of the first state: S numbers, read-only."""
        return self._initial_belief

    @property
    def pomdp(self) -> POMDP | None:
        """The model itself, if its state is known only by observations; None for an MDP."""
        return None

    @property
    def event_observations(self) -> bool:
        """Whether observations are those of events, P(o | s, a, s'); an MDP has none."""
        return False

    @property
    def num_agents(self) -> int:
        """The number of agents: one per factor of the action space."""
        return len(self.action_space.factors)

    @property
    def is_sparse(self) -> bool:
        """Whether the matrices are CSR."""
        return is_compressed(self.transition_matrix(0))

    def transition_matrix(self, action: Symbol) -> Matrix:
        """Return P(s' | s, a) as an S x S' matrix, read-only."""
        return self._transitions[self.action_space.index(action)]

    @overload
    def transition(self, action: Symbol, state: Symbol) -> Vector: ...

    @overload
    def transition(self, action: Symbol, state: Symbol, next_state: Symbol) -> float: ...

    def transition(self, action: Symbol, state: Symbol, next_state: Symbol | None = None) -> Vector | float:
        """Return P(s' | s, a), by names or indices: the row over s' (S numbers), or a single entry."""
        matrix = self.transition_matrix(action)
        row = self.state_space.index(state)
        if next_state is not None:
            return float(matrix[row, self.state_space.index(next_state)])
        return matrix_row(matrix, row)

    def reward(
        self,
        action: Symbol,
        state: Symbol,
        next_state: Symbol | None = None,
        observation: Symbol | None = None,
    ) -> float:
        """Return the immediate reward, by names or indices: of an outcome if the model has it, else R(s, a)."""
        a, s = self.action_space.index(action), self.state_space.index(state)
        if next_state is None or self.outcome_rewards is None:
            return float(self.rewards[s, a])
        observed = None if observation is None else self._observation_index(observation)
        return self.outcome_rewards.at(a, s, self.state_space.index(next_state), observed)

    def _observation_index(self, observation: Symbol) -> int:
        raise ModelError(f"an MDP has no observation {observation!r}")

    def with_discount(self, discount: float, *, of: Unit | None = None) -> Self:
        """Return the same model with another discount.

        Args:
            discount: In (0, 1].
            of: Its time: ``"step"``, the seconds of a step, or ``"second"``, for a model whose actions take the
                time that `Durations` say. By default the old one.
        """
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other.discount = checked_discount(discount)
        if of is not None:
            other.discount_of = checked_unit(of)
        return other

    def timed_as(self, model: MDP) -> Self:
        """Return the same model, with the discount of one that it was made of."""
        if (self.discount, self.discount_of) == (model.discount, model.discount_of):
            return self
        return self.with_discount(model.discount, of=model.discount_of)

    @property
    def false_negative(self) -> int | None:
        """The index of the false negative among the observations; None if there is none, as in an MDP."""
        return None

    def with_false_negatives(self, symbol: Symbol | None) -> Self:
        """Return the model itself for None: an MDP has no observations. See `POMDP.with_false_negatives`.

        Raises:
            ModelError: If an observation is named.
        """
        if symbol is None:
            return self
        raise ModelError("an MDP has no observations, and so no false negatives")

    def sparingly(self, keeper: Keeper | None = None) -> Self:
        """Return the same model for a process whose memory counts for more than microseconds, such as a team's agent.

        Beliefs and rewards of a factored model are computed on its network unless its matrices are small, and what is
        small is not compiled, since the compiler alone takes more than 100 MB.

        Args:
            keeper: Where a factored model is to take its matrices from, if it needs them; by default it makes them.
        """
        other = copy.copy(self)
        other.is_sparing = True
        other._keeper = keeper  # noqa: SLF001 - a model of the same kind
        return other

    def bare(self) -> Self:
        """Return the same model without the things made of it, to send to another process; a flat model is itself."""
        return self

    def flatten(self) -> MDP:
        """Return the model as matrices; a flat model returns itself."""
        return self

    @property
    def matrix_size(self) -> MatrixSize:
        """How large its matrices are, or would be; they are not made for it."""
        actions = range(len(self.action_space))
        transitions = [self.transition_matrix(action) for action in actions]
        kinds = {id(matrix): matrix for matrix in transitions}.values()
        observations, seen = self._observations_size(transitions)
        return MatrixSize(
            held_bytes(transitions),
            observations,
            len(self.state_space) * len(actions) * 8,
            len(kinds),
            sum(map(num_entries, kinds)) // len(kinds),
            seen,
        )

    def _observations_size(self, transitions: Sequence[Matrix]) -> tuple[int, int]:
        """Return the bytes of O, and its entries for an action."""
        return 0, 0

    @property
    def is_flattened(self) -> bool:
        """Whether its matrices have been made; a flat model is its matrices."""
        return True

    def step_by_step(self) -> Self:
        """Return the same model for an agent that is told of each time step; an MDP is itself.

        See `POMDP.step_by_step`.
        """
        return self

    def revealed(self) -> MDP:
        """Return the model whose observations include fully observed factors (`POMDP.revealed`); an MDP is itself."""
        return self

    def marginalize(self, factor: str) -> MDP:
        """Return the model without a state factor on whose present value nothing else depends.

        Raises:
            ModelError: If there is no such factor, it is the only one, or transitions or rewards depend on it.
        """
        from mdm.models.factored.marginalisation import marginalize  # noqa: PLC0415 - it makes models of this kind

        return marginalize(self, factor).timed_as(self)

    def __repr__(self) -> str:
        return f"<{self.kind}: {counted(len(self.state_space), 'state')}, {counted(len(self.action_space), 'action')}>"


def as_space(name: str, given: Space | Iterable[str] | int | None, count: int) -> Space:
    """Return the space of some names or a number; by default, of a count."""
    if isinstance(given, Space):
        return given
    return Space.single(name, count if given is None else given)


def _is_matrices(given: Any) -> bool:
    """Whether something is a sequence of matrices, and so has one for each action."""
    return isinstance(given, list | tuple) and any(
        isinstance(each, np.ndarray) or is_compressed(each) for each in given
    )


def _actions_first(given: npt.ArrayLike) -> Any:
    array = np.asarray(given)
    return array.swapaxes(0, 1) if array.ndim > 2 else array


def checked_discount(discount: float) -> float:
    """Return a discount.

    Raises:
        ModelError: If it is not in (0, 1].
    """
    if not (is_number(discount) and 0 < discount <= 1):
        raise ModelError(f"a discount is more than 0 and at most 1, not {discount!r}")
    return float(discount)


def matrix_row(matrix: Matrix, row: int) -> Vector:
    """Return a row of a dense or sparse matrix, dense and read-only."""
    values = np.asarray(matrix[[row]].toarray()).ravel() if is_compressed(matrix) else matrix[row]
    values = values.view()
    values.flags.writeable = False
    return values
