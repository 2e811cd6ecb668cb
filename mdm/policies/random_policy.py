"""The policy that chooses at random: what every other should beat."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from mdm.errors import ModelError

__all__ = ["RandomPolicy"]


class RandomPolicy:
    """Chooses every action with the same probability, whatever the state or belief.

    Args:
        num_actions: How many actions there are.
        num_states: How many states the model has.
        seed: Makes the draws reproducible.
        input: What it is asked with: a ``state``, or a ``belief``.

    Raises:
        ModelError: If there is no action or no state, or it is to be asked with something else.
    """

    def __init__(
        self,
        num_actions: int,
        num_states: int,
        *,
        seed: int | None = None,
        input: Literal["state", "belief"] = "belief",  # noqa: A002 - as every policy calls it
    ) -> None:
        check_sizes(num_actions, num_states, input)
        self.num_actions = num_actions
        self.num_states = num_states
        self.input: Literal["state", "belief"] = input
        self._generator = np.random.default_rng(seed)

    def action(self, x: Any, /) -> int:  # noqa: ARG002 - a policy's signature
        """Draw an action."""
        return int(self._generator.integers(self.num_actions))

    def value(self, x: Any, /) -> float:
        """Return the value of a state or belief, which this policy does not know.

        Raises:
            ModelError: Always.
        """
        raise ModelError(f"a RandomPolicy holds no values, so that of {x!r} is unknown: evaluate it on its model")

    def seed(self, seed: int | None) -> None:
        """Begin the draws anew."""
        self._generator = np.random.default_rng(seed)


def check_sizes(num_actions: int, num_states: int, given: str) -> None:
    """Refuse sizes below 1, and what no policy is asked with.

    Raises:
        ModelError: If there is such.
    """
    for count, what in ((num_actions, "action"), (num_states, "state")):
        if count < 1:
            raise ModelError(f"a policy needs at least one {what}, not {count}")
    if given not in {"state", "belief"}:
        raise ModelError(f"a policy's input is 'state' or 'belief', not {given!r}")
