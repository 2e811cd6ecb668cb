"""Policies with a horizon: what is best depends on how many decisions are left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import numbers
from mdm.policies.table import QTable

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["StagedPolicy"]


class StagedPolicy:
    """Values of actions per state and stage: the best is chosen, of equal ones that with the lowest index.

    Stage 0 is the first decision of an episode. What asks without a stage gets the first decision, and what is asked
    beyond the last stage is an error.

    Args:
        values: H x S x A, the value of each action in each state, with H, H - 1, ... 1 decisions to go.

    Raises:
        ModelError: If a value is NaN.
    """

    input: Literal["state"] = "state"

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

    def action(self, state: int, stage: int = 0) -> int:
        """Return the best action in a state at a stage."""
        return int(self._row(state, stage).argmax())

    def value(self, state: int, stage: int = 0) -> float:
        """Return what is expected from a state at a stage to the horizon."""
        return float(self._row(state, stage).max())

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
