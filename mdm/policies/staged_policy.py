"""Policies with a finite horizon, where the best action depends on the number of decisions left."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from mdm.beliefs import KnownState
from mdm.errors import ModelError
from mdm.models.matrices import numbers
from mdm.policies.batch import TableBatch
from mdm.policies.policy import Scores, StatePolicy
from mdm.policies.table import QTable

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch
    from mdm.policies.policy import Arrays, Packed

__all__ = ["StagedPolicy"]


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
