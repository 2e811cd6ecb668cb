"""The policy that chooses at random: what every other should beat."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.beliefs import Drawn, DrawnInformation, KnownState
from mdm.errors import ModelError
from mdm.policies.batch import ProbabilityBatch
from mdm.policies.policy import BeliefPolicy, StatePolicy

if TYPE_CHECKING:
    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch

__all__ = ["RandomPolicy"]


class Unknowing(StatePolicy):
    """A policy to which states and beliefs are all the same: it is asked with either.

    Args:
        num_actions: How many actions there are.
        num_states: How many states the model has.
        asked_with: A ``state``, or a ``belief``.

    Raises:
        ModelError: If there is no action or no state, or it is to be asked with something else.
    """

    input: Literal["state", "belief"]  # type: ignore[assignment]
    by_support = True

    def __init__(self, num_actions: int, num_states: int, asked_with: str) -> None:
        for count, what in ((num_actions, "action"), (num_states, "state")):
            if count < 1:
                raise ModelError(f"a policy needs at least one {what}, not {count}")
        if asked_with not in {"state", "belief"}:
            raise ModelError(f"a policy's input is 'state' or 'belief', not {asked_with!r}")
        self.num_actions = num_actions
        self.num_states = num_states
        self.input = asked_with  # type: ignore[assignment]

    def information(self, model: MDP | None) -> Information:
        """Return the state, or the belief's tracker."""
        return KnownState() if self.input == "state" else BeliefPolicy.information(self, model)  # type: ignore[arg-type]


class RandomPolicy(Unknowing):
    """Chooses every action with the same probability, whatever the state or belief.

    Args:
        num_actions: How many actions there are.
        num_states: How many states the model has.
        seed: Makes the draws reproducible.
        input: What it is asked with: a ``state``, or a ``belief``.

    Raises:
        ModelError: If there is no action or no state, or it is to be asked with something else.
    """

    form = "actions at random"

    def __init__(
        self,
        num_actions: int,
        num_states: int,
        *,
        seed: int | None = None,
        input: Literal["state", "belief"] = "belief",  # noqa: A002 - as every policy calls it
    ) -> None:
        super().__init__(num_actions, num_states, input)
        self.seed(seed)

    def information(self, model: MDP | None) -> Information:
        """Return the state or the belief's tracker, with numbers: the same seed makes the same decisions."""
        return DrawnInformation(super().information(model), self._seed)

    def action(self, x: Any, /) -> int:
        """Draw an action."""
        number = x.number if isinstance(x, Drawn) else self._generator.random()
        return int(number * self.num_actions)

    def weights(self, stage: int = 0) -> Vector:  # noqa: ARG002 - the same at all stages
        """Return the probability of each action in each state, A x S."""
        return np.full((self.num_actions, self.num_states), 1 / self.num_actions)

    def batch(self, model: MDP) -> Batch:  # noqa: ARG002 - nothing of it matters
        """Return its decisions for many episodes at once."""
        return ProbabilityBatch(self.weights())

    def seed(self, seed: int | None) -> None:
        """Begin the draws anew."""
        self._seed = seed
        self._generator = np.random.default_rng(seed)
