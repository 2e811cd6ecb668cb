"""Policies with a horizon: what is best depends on how many decisions are left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from mdm.beliefs import KnownState
from mdm.errors import ModelError
from mdm.models.matrices import numbers
from mdm.policies.batch import TableBatch
from mdm.policies.policy import StatePolicy
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
    """A state, and how many decisions were made before."""

    state: int
    stage: int


class StagedState(KnownState):
    """A state that is seen, at a stage.

    Args:
        horizon: How many stages there are.
    """

    def __init__(self, horizon: int) -> None:
        super().__init__()
        self.horizon = horizon
        self._stage = -1

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Forget the state, and begin at the first stage."""
        super().reset(belief)
        self._stage = -1

    def update(self, action: int | None, observation: int | None) -> float:  # noqa: ARG002 - as any information
        """Take the state that is seen, at the next stage. Return 1."""
        self._stage += 1
        self.current = Staged(self.current.state if observation is None else observation, self._stage)
        return 1.0

    def expected(self, values: Vector) -> float:
        """Return the value of the state, of S numbers."""
        return float(values.item(self.current.state))

    def snapshot(self) -> Any:
        """Return the state and the stage."""
        return [None if self.current is None else self.current.state, self._stage]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        state, self._stage = snapshot
        self.current = None if state is None else Staged(state, self._stage)


class StagedPolicy(StatePolicy):
    """Values of actions per state and stage: the best is chosen, of equal ones that with the lowest index.

    Stage 0 is the first decision of an episode. What asks without a stage gets the first decision, and what is asked
    beyond the last stage is an error.

    Args:
        values: H x S x A, the value of each action in each state, with H, H - 1, ... 1 decisions to go.

    Raises:
        ModelError: If a value is NaN.
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

    def information(self, model: MDP | None) -> Information:  # noqa: ARG002 - the state is seen
        """Return the state at the first stage."""
        return StagedState(self.horizon)

    def action(self, state: int | Staged, stage: int = 0) -> int:
        """Return the best action in a state at a stage."""
        if isinstance(state, Staged):
            state, stage = state
        return int(self._row(state, stage).argmax())

    def value(self, state: int, stage: int = 0) -> float:
        """Return what is expected from a state at a stage to the horizon."""
        return float(self._row(state, stage).max())

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state at a stage, A x S."""
        return self.at(stage).weights()

    def value_at(self, belief: Vector) -> float:
        """Return the expected value of the states at the first stage."""
        return float(belief @ self.values[0].max(axis=1))

    def batch(self, model: MDP) -> Batch:  # noqa: ARG002 - the tables are enough
        """Return its decisions for many episodes at once."""
        return TableBatch(self.values.argmax(axis=2))

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {}, {"values": self.values}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:  # noqa: ARG003
        """Return the policy that was packed."""
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
