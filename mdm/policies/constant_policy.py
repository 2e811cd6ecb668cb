"""The policy that always chooses the same action: a baseline, and a fallback."""

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
        num_actions: The number of actions.
        num_states: The number of states.
        input: The input of `action`: a ``state`` or a ``belief``.

    Raises:
        ModelError: If there is no such action, no state, or no such input.

    Example::

        mdm.policies.ConstantPolicy(1, num_actions=3, num_states=2).action([0.5, 0.5])  # 1
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

    def batch(self, model: MDP) -> Batch:  # noqa: ARG002 - the action is enough
        """Return its decisions for a batch of episodes."""
        return TableBatch(np.full((1, self.num_states), self._action))
