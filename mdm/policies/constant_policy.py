"""The policy that always does the same: a baseline, and what an agent without a plan falls back to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.policies.batch import TableBatch
from mdm.policies.random_policy import Unknowing

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch

__all__ = ["ConstantPolicy"]


class ConstantPolicy(Unknowing):
    """Chooses one action, whatever the state or belief.

    Args:
        action: The action's index.
        num_actions: How many actions there are.
        num_states: How many states the model has.
        input: What it is asked with: a ``state``, or a ``belief``.

    Raises:
        ModelError: If there is no such action or no state, or it is to be asked with something else.
    """

    form = "always the same action"

    def __init__(
        self,
        action: int,
        num_actions: int,
        num_states: int,
        *,
        input: Literal["state", "belief"] = "belief",  # noqa: A002 - as every policy calls it
    ) -> None:
        super().__init__(num_actions, num_states, input)
        if not 0 <= action < num_actions:
            raise ModelError(f"there is no action {action}; the actions are 0 to {num_actions - 1}")
        self._action = int(action)

    def action(self, x: Any, /) -> int:  # noqa: ARG002 - a policy's signature
        """Return the action."""
        return self._action

    def weights(self, stage: int = 0) -> Vector:  # noqa: ARG002 - the same at all stages
        """Return the probability of each action in each state, A x S."""
        result = np.zeros((self.num_actions, self.num_states))
        result[self._action] = 1
        return result

    def batch(self, model: MDP) -> Batch:  # noqa: ARG002 - nothing of it matters
        """Return its decisions for many episodes at once."""
        return TableBatch(np.full((1, self.num_states), self._action))
