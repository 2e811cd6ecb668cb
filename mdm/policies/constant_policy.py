"""The policy that always does the same: a baseline, and what an agent without a plan falls back to."""

from __future__ import annotations

from typing import Any, Literal

from mdm.errors import ModelError
from mdm.policies.random_policy import check_sizes

__all__ = ["ConstantPolicy"]


class ConstantPolicy:
    """Chooses one action, whatever the state or belief.

    Args:
        action: The action's index.
        num_actions: How many actions there are.
        num_states: How many states the model has.
        input: What it is asked with: a ``state``, or a ``belief``.

    Raises:
        ModelError: If there is no such action or no state, or it is to be asked with something else.
    """

    def __init__(
        self,
        action: int,
        num_actions: int,
        num_states: int,
        *,
        input: Literal["state", "belief"] = "belief",  # noqa: A002 - as every policy calls it
    ) -> None:
        check_sizes(num_actions, num_states, input)
        if not 0 <= action < num_actions:
            raise ModelError(f"there is no action {action}; the actions are 0 to {num_actions - 1}")
        self.num_actions = num_actions
        self.num_states = num_states
        self.input: Literal["state", "belief"] = input
        self._action = int(action)

    def action(self, x: Any, /) -> int:  # noqa: ARG002 - a policy's signature
        """Return the action."""
        return self._action

    def value(self, x: Any, /) -> float:
        """Return the value of a state or belief, which this policy does not know.

        Raises:
            ModelError: Always.
        """
        raise ModelError(f"a ConstantPolicy holds no values, so that of {x!r} is unknown: evaluate it on its model")
