"""Baselines: the uniformly random policy, and the one that always chooses the same action, which is a fallback, too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.beliefs import Drawn, DrawnInformation, KnownState
from mdm.errors import ModelError
from mdm.policies.batch import ProbabilityBatch, TableBatch
from mdm.policies.policy import BeliefPolicy, Scores, StatePolicy

if TYPE_CHECKING:
    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch


class Unknowing(StatePolicy):
    """The base of policies that ignore the state or belief.

    Args:
        num_actions: The number of actions.
        num_states: The number of states.
        asked_with: The input of `action`: a ``state`` or a ``belief``.

    Raises:
        ModelError: If there is no action, no state, or no such input.
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
        """Return the state or a belief tracker."""
        return KnownState() if self.input == "state" else BeliefPolicy.information(self, model)  # type: ignore[arg-type]


class RandomPolicy(Unknowing):
    """Chooses every action with the same probability, in every state or belief.

    Args:
        num_actions: The number of actions.
        num_states: The number of states.
        seed: The seed of the draws.
        input: The input of `action`: a ``state`` or a ``belief``.

    Raises:
        ModelError: If there is no action, no state, or no such input.

    Example::

        random = mdm.policies.RandomPolicy(num_actions=3, num_states=2, seed=1)
        mdm.evaluate("tiger.pomdp", random, episodes=100, seed=1).mean < 0  # True
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
        """Return the state or a belief tracker, with random numbers: equal seeds give equal decisions."""
        return DrawnInformation(super().information(model), self._seed)

    def action(self, x: Any, /) -> int:
        """Draw an action."""
        number = x.number if isinstance(x, Drawn) else self._generator.random()
        return int(number * self.num_actions)

    def scores(self, x: Any, /) -> Scores:
        """Return the probabilities of its actions."""
        return Scores("chance", np.full(self.num_actions, 1 / self.num_actions))

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state, A x S."""
        return np.full((self.num_actions, self.num_states), 1 / self.num_actions)

    def batch(self, model: MDP) -> Batch:
        """Return its decisions for a batch of episodes."""
        return ProbabilityBatch(self.weights())

    def seed(self, seed: int | None) -> None:
        """Restart the draws from a seed."""
        self._seed = seed
        self._generator = np.random.default_rng(seed)


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

    def action(self, x: Any, /) -> int:
        """Return the action."""
        return self._action

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state, A x S."""
        result = np.zeros((self.num_actions, self.num_states))
        result[self._action] = 1
        return result

    def batch(self, model: MDP) -> Batch:
        """Return its decisions for a batch of episodes."""
        return TableBatch(np.full((1, self.num_states), self._action))
