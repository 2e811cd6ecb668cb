"""Policies over states as tables: actions, probabilities of actions, or values of actions.

With a finite horizon the best action depends on the number of decisions left: there is a table of values a stage.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, SupportsIndex

import numpy as np

from mdm.beliefs import Drawn, DrawnInformation, KnownState
from mdm.errors import ModelError
from mdm.models.matrices import numbers
from mdm.policies.batch import ProbabilityBatch, TableBatch
from mdm.policies.policy import Scores, StatePolicy, listed, whole

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch
    from mdm.policies.policy import Arrays, Packed

_ROUNDING = 1e-12
"""Smaller errors of a sum are not normalised, so that a written policy is read again bit by bit."""


class _Table(StatePolicy):
    """A policy with an entry per state."""

    def batch(self, model: MDP) -> Batch:
        """Return its decisions for a batch of episodes."""
        return TableBatch(np.array([[self.action(state) for state in range(self.num_states)]]))

    def _refuse(self, state: int) -> ModelError:
        return ModelError(f"there is no state {state}; the policy is for {self.num_states} states, which count from 0")

    def _named(self, state: Any) -> int:
        """Return the index of a state that is none itself: of a name of the policy's model.

        Raises:
            ModelError: If it is no name, or the policy knows no names.
        """
        if self.state_space is None:
            raise ModelError(
                f"the policy knows its {self.num_states} states by index alone, not by names such as {state!r}: solve "
                f"the model, or load the policy with it"
            )
        return self.state_space.index(state)


class DeterministicPolicy(_Table):
    """One action per state.

    Args:
        actions: S action indices.
        num_actions: The number of actions; by default one more than the largest.

    Raises:
        ModelError: If an entry is not an action.

    Example::

        mdm.policies.DeterministicPolicy([1, 0]).action(0)  # 1
    """

    kind: ClassVar[str] = "deterministic"
    form = "an action per state"

    def __init__(self, actions: Iterable[int], num_actions: int | None = None) -> None:
        self._actions: list[int] = []
        if type(self).action is DeterministicPolicy.action:  # not overridden
            self.table = self._actions
        for state, action in enumerate(actions):
            if not isinstance(action, SupportsIndex):
                raise ModelError(f"the policy's entry for state {state} is {action!r}, but an action's index is needed")
            self._actions.append(operator.index(action))
        if not self._actions:
            raise ModelError("a policy needs at least one state")
        self.num_states = len(self._actions)
        self.num_actions = max(self._actions) + 1 if num_actions is None else num_actions
        for state, action in enumerate(self._actions):
            if not 0 <= action < self.num_actions:
                raise ModelError(
                    f"the policy's entry for state {state} is {action}, but its actions are 0 to {self.num_actions - 1}"
                )

    def action(self, state: int) -> int:
        """Return the action for a state, by index; or by name, where the policy was solved or loaded with its model."""
        try:
            if 0 <= state < self.num_states:
                return self._actions[state]
        except TypeError:
            return self._actions[self._named(state)]
        raise self._refuse(state)

    @property
    def actions(self) -> tuple[int, ...]:
        """The action per state."""
        return tuple(self._actions)

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {"actions": self.num_actions}, {"actions": whole(self._actions)}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        return cls(listed(arrays["actions"]), sizes["actions"])


class StochasticPolicy(_Table):
    """Probabilities of actions per state, drawn from at each decision.

    Args:
        probabilities: A x S, the probability of action (row) in state (column); columns sum to 1.
        seed: The seed of the draws.

    Raises:
        ModelError: If a column is not a distribution.

    Example::

        policy = mdm.policies.StochasticPolicy([[1.0, 0.5], [0.0, 0.5]], seed=1)
        policy.action(0)  # 0
    """

    kind: ClassVar[str] = "stochastic"
    form = "probabilities of actions per state"

    def __init__(self, probabilities: npt.ArrayLike, *, seed: int | None = None) -> None:
        matrix = numbers(probabilities, "the array of probabilities")
        if matrix.ndim != 2 or 0 in matrix.shape:
            raise ModelError(f"a stochastic policy is an actions x states array, not one of shape {matrix.shape}")
        self.num_actions, self.num_states = matrix.shape
        sums = matrix.sum(axis=0)
        bad = ~(np.isfinite(matrix).all(axis=0) & (matrix >= 0).all(axis=0) & (np.abs(sums - 1) <= 1e-4))
        if bad.any():
            state = int(bad.argmax())
            column = ", ".join(f"{p:g}" for p in matrix[:, state])
            raise ModelError(
                f"the probabilities of actions in state {state} are not a distribution: {column} sum to {sums[state]:g}"
            )
        matrix /= np.where(np.abs(sums - 1) > _ROUNDING, sums, 1.0)
        matrix.setflags(write=False)
        self.probabilities = matrix
        cumulative = np.cumsum(matrix, axis=0)
        cumulative /= cumulative[-1]  # or rounding could lead to an action of probability 0
        self._cumulative = np.ascontiguousarray(cumulative.T)
        self.seed(seed)

    def information(self, model: MDP | None) -> Information:
        """Return the state with random numbers: equal seeds give equal decisions."""
        return DrawnInformation(KnownState(), self._seed)

    def action(self, state: int | Drawn) -> int:
        """Draw an action for a state."""
        index, number = state if isinstance(state, Drawn) else (state, self._generator.random())
        if not 0 <= index < self.num_states:
            raise self._refuse(index)
        return int(self._cumulative[index].searchsorted(number, side="right"))

    def scores(self, state: int | Drawn, /) -> Scores:
        """Return the probabilities of its actions in a state."""
        index = state.by if isinstance(state, Drawn) else state
        if not 0 <= index < self.num_states:
            raise self._refuse(index)
        return Scores("chance", self.probabilities[:, index])

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state, A x S."""
        return self.probabilities

    def batch(self, model: MDP) -> Batch:
        """Return its decisions for a batch of episodes."""
        return ProbabilityBatch(self.probabilities)

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {}, {"probabilities": self.probabilities}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        return cls(arrays["probabilities"], seed=seed)

    def seed(self, seed: int | None) -> None:
        """Restart the draws from a seed."""
        self._seed = seed
        self._generator = np.random.default_rng(seed)


class QTable(_Table):
    """Values of actions per state: chooses the greatest value, of equal ones the lowest index.

    Args:
        values: S x A, the value of each action in each state.

    Raises:
        ModelError: If a value is NaN.

    Example::

        policy = mdm.policies.QTable([[0.0, 5.0], [2.0, 1.0]])
        policy.action(0), policy.value(0)  # 1, 5.0
    """

    kind: ClassVar[str] = "q"
    form = "values of actions per state"

    def __init__(self, values: npt.ArrayLike) -> None:
        table = numbers(values, "the Q-table")
        if table.ndim != 2 or 0 in table.shape:
            raise ModelError(f"a Q-table is a states x actions array, not one of shape {table.shape}")
        if np.isnan(table).any():
            state, action = (int(place[0]) for place in np.nonzero(np.isnan(table)))
            raise ModelError(f"the Q-table's value of action {action} in state {state} is NaN")
        table.setflags(write=False)
        self.values = table
        self.num_states, self.num_actions = table.shape
        self._actions: list[int] = table.argmax(axis=1).tolist()
        if type(self).action is QTable.action:  # not overridden
            self.table = self._actions

    def action(self, state: int) -> int:
        """Return the best action in a state, by index; or by name, where it was solved or loaded with its model."""
        try:
            if 0 <= state < self.num_states:
                return self._actions[state]
        except TypeError:
            return self._actions[self._named(state)]
        raise self._refuse(state)

    def value(self, state: int) -> float:
        """Return the value of the best action in a state."""
        if not 0 <= state < self.num_states:
            raise self._refuse(state)
        return float(self.values[state].max())

    def scores(self, state: int, /) -> Scores:
        """Return the values of its actions in a state."""
        if not 0 <= state < self.num_states:
            raise self._refuse(state)
        return Scores("value", self.values[state])

    def value_at(self, belief: Vector) -> float:
        """Return the expected value of the states."""
        return float(belief @ self.values.max(axis=1))

    def for_first_states(self, count: int) -> QTable:
        """Return its rows for the first so many states."""
        return QTable(self.values[:count])

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {}, {"values": self.values}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        return cls(arrays["values"])


# -- Stages ------------------------------------------------------------------------------------------------------------


class Staged(NamedTuple):
    """A state, and the number of decisions before."""

    state: int
    stage: int


class StagedState(KnownState):
    """An observed state, and its stage.

    Args:
        horizon: The number of stages.
    """

    def __init__(self, horizon: int) -> None:
        super().__init__()
        self.horizon = horizon
        self._stage = -1

    @property
    def state(self) -> int | None:
        """The state's index; None until one is seen."""
        return None if self.current is None else int(self.current.state)

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Forget the state, and begin at the first stage."""
        super().reset(belief)
        self._stage = -1

    def update(self, action: int | None, observation: int | None) -> float:
        """Set the state, at the next stage. Return 1."""
        self._stage += 1
        self.current = Staged(self.current.state if observation is None else observation, self._stage)
        return 1.0

    def expected(self, values: Vector) -> float:
        """Return the state's entry of S values."""
        return float(values.item(self.current.state))

    def snapshot(self) -> Any:
        """Return the state and the stage."""
        return [None if self.current is None else self.current.state, self._stage]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot.

        Raises:
            ModelError: If there is no such stage; the state is unchanged.
        """
        state, stage = snapshot
        if not -1 <= operator.index(stage) <= self.horizon:
            raise ModelError(f"there is no stage {stage} of {self.horizon}")
        self._stage = stage
        self.current = None if state is None else Staged(state, stage)


class StagedPolicy(StatePolicy):
    """A Q-table per stage: chooses the action of the greatest value, of equal ones the lowest index.

    Stage 0, the default, is the first decision of an episode. A stage beyond the last is an error.

    Args:
        values: H x S x A, the value of each action in each state, with H, H - 1, ... 1 decisions to go.

    Raises:
        ModelError: If a value is NaN.

    Example::

        policy = mdm.policies.StagedPolicy([[[0, 3]], [[1, 0]]])  # 2 stages, 1 state, 2 actions
        policy.action(0), policy.action(0, stage=1)  # 1, 0
    """

    kind: ClassVar[str] = "staged"
    form = "values of actions per state and decision"
    horizon: int

    def __init__(self, values: npt.ArrayLike) -> None:
        table = numbers(values, "the Q-tables of the stages")
        if table.ndim != 3 or 0 in table.shape:
            raise ModelError(
                f"Q-tables of stages are a stages x states x actions array, not one of shape {table.shape}"
            )
        if np.isnan(table).any():
            stage, state, action = (int(place[0]) for place in np.nonzero(np.isnan(table)))
            raise ModelError(f"at stage {stage} the value of action {action} in state {state} is NaN")
        table.setflags(write=False)
        self.values = table
        self.horizon, self.num_states, self.num_actions = table.shape

    def information(self, model: MDP | None) -> Information:
        """Return the state at the first stage."""
        return StagedState(self.horizon)

    def action(self, state: int | Staged, stage: int = 0) -> int:
        """Return the best action in a state at a stage."""
        if isinstance(state, Staged):
            state, stage = state
        return int(self._row(state, stage).argmax())

    def value(self, state: int, stage: int = 0) -> float:
        """Return the expected return from a state at a stage to the horizon."""
        return float(self._row(state, stage).max())

    def scores(self, state: int | Staged, /, stage: int = 0) -> Scores:
        """Return the values of its actions in a state at a stage."""
        if isinstance(state, Staged):
            state, stage = state
        return Scores("value", self._row(state, stage))

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state at a stage, A x S."""
        return self.at(stage).weights()

    def value_at(self, belief: Vector) -> float:
        """Return the expected value of the states at the first stage."""
        return float(belief @ self.values[0].max(axis=1))

    def batch(self, model: MDP) -> Batch:
        """Return its decisions for a batch of episodes."""
        return TableBatch(self.values.argmax(axis=2))

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {}, {"values": self.values}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        return cls(arrays["values"])

    def at(self, stage: int) -> QTable:
        """Return the policy of one stage."""
        if not 0 <= stage < self.horizon:
            raise self._refuse(stage)
        return QTable(self.values[stage])

    def _row(self, state: int, stage: int) -> npt.NDArray[np.float64]:
        if not 0 <= stage < self.horizon:
            raise self._refuse(stage)
        if not 0 <= state < self.num_states:
            raise ModelError(
                f"there is no state {state}; the policy is for {self.num_states} states, which count from 0"
            )
        row: npt.NDArray[np.float64] = self.values[stage, state]
        return row

    def _refuse(self, stage: int) -> ModelError:
        return ModelError(f"there is no stage {stage}; the policy is for {self.horizon}, which count from 0")
