"""Rewards of all forms, reduced to the expected immediate reward R(s, a).

R(s, a) = sum over s' of T(s' | s, a) times the sum over o of O(o | a, s') R(a, s, s', o) (L. P. Kaelbling, M. L.
Littman and A. R. Cassandra, *Planning and acting in partially observable stochastic domains*, Artificial Intelligence
101, 1998, section 3). The rewards of single outcomes are kept beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mdm.errors import ModelError
from mdm.models.availability import HINT
from mdm.models.matrices import Checked, Matrix, Vector, is_compressed, numbers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models.space import Space


class OutcomeRewards(Protocol):
    """Rewards that depend on the outcome of an action."""

    def at(self, action: int, state: int, next_state: int, observation: int | None) -> float:
        """Return R(a, s, s', o); the observation may be None if the reward does not depend on it."""
        ...

    def array(self, largest: int) -> Vector | None:
        """Return an A x S x S' or A x S x S' x O array; None if it would have more than ``largest`` entries."""
        ...


class RewardArray:
    """Rewards of outcomes as an A x S x S' or A x S x S' x O array."""

    def __init__(self, values: Vector) -> None:
        self.values = values
        values.setflags(write=False)

    def at(self, action: int, state: int, next_state: int, observation: int | None) -> float:
        """Return R(a, s, s', o).

        Raises:
            ModelError: If it depends on the observation, and that is None.
        """
        if self.values.ndim == 3:
            return float(self.values[action, state, next_state])
        if observation is None:
            raise ModelError("the reward depends on the observation: name one")
        return float(self.values[action, state, next_state, observation])

    def array(self, largest: int) -> Vector | None:
        """Return the array; None if it has more than ``largest`` entries."""
        return self.values if self.values.size <= largest else None


def reward_numbers(given: Any, num_actions: int) -> Any:
    """Return rewards as an S x A, A x S x S' or A x S x S' x O array; R(s) becomes S x A.

    They are copied, but for one array of them that is `Checked`.

    Raises:
        ModelError: If they have another shape.
    """
    array = given[0] if isinstance(given, Checked) else numbers(given, "the array of rewards")
    if array.ndim == 1 and array.size:
        return np.repeat(array[:, None], num_actions, axis=1)
    if array.ndim not in {2, 3, 4} or 0 in array.shape or (array.ndim > 2 and array.shape[1] != array.shape[2]):
        raise ModelError(
            "the rewards are a states x actions array, or one over states, over actions x states x states, or over "
            f"actions x states x states x observations, not one of shape {array.shape}"
        )
    return array


def expected_rewards(
    outcomes: Vector, transitions: Sequence[Matrix], chances: Callable[[int, Any, Any], Vector] | None
) -> Vector:
    """Return R(s, a), S x A.

    Args:
        outcomes: A x S x S', or A x S x S' x O.
        transitions: T per action.
        chances: For rewards of observations: returns P(o | s, a, s'), a row per transition, for an action and arrays
            of states and next states.
    """
    result = np.zeros((outcomes.shape[1], outcomes.shape[0]))
    for action, transition in enumerate(transitions):
        states, next_states = transition.nonzero() if is_compressed(transition) else np.nonzero(transition)
        values = outcomes[action][states, next_states]
        if outcomes.ndim == 4:
            assert chances is not None
            values = (values * chances(action, states, next_states)).sum(axis=1)
        weights = np.asarray(transition[states, next_states]).ravel() * values
        result[:, action] = np.bincount(states, weights, minlength=len(result))
    return result


def check_finite(expected: Vector, states: Space, actions: Space) -> None:
    """Refuse rewards that are not finite.

    Raises:
        ModelError: With the action and the state.
    """
    if not np.isfinite(expected).all():
        state, action = (int(place[0]) for place in np.nonzero(~np.isfinite(expected)))
        raise ModelError(
            f"the reward of action {actions.names[action]!r} in state {states.names[state]!r} is "
            f"{expected[state, action]}, not a finite number" + (f": {HINT}" if expected[state, action] < 0 else "")
        )
