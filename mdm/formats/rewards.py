"""Rewards as statements over (a, s, s', o), reduced to the expected R(s, a).

R(s, a) is the sum over s' of T(s' | s, a) times the sum over o of O(o | a, s') R(a, s, s', o). The last statement that
covers an entry counts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Rewards"]

_LIMIT = 20_000_000


class Rewards:
    """Collects reward statements in the order of a file.

    Args:
        num_actions: A.
        num_states: S.
        num_observations: O; 0 for an MDP.
    """

    def __init__(self, num_actions: int, num_states: int, num_observations: int) -> None:
        self._shape = (num_actions, num_states, num_observations)
        self._statements: list[tuple[Any, Any, Any, Any, Any]] = []

    def add(
        self,
        action: int | Sequence[int] | None,
        state: int | None,
        next_state: int | None,
        observation: int | None,
        value: float | npt.NDArray[np.float64],
    ) -> None:
        """Add a statement; None stands for all, a list for several actions.

        ``value`` is a number; a row over the observations (over the next states in an MDP) where ``observation`` is
        None; or a matrix over next states and observations where ``next_state`` is None too (over states and next
        states in an MDP).
        """
        self._statements.append((action, state, next_state, observation, value))

    def expected(self, transitions: Sequence[Any], observations: Sequence[Any] | None) -> npt.NDArray[np.float64]:
        """Return R(s, a), an S x A array."""
        num_actions, num_states, _ = self._shape
        result = np.zeros((num_states, num_actions))
        by_action: list[list[tuple[Any, Any, Any, Any]]] = [[] for _ in range(num_actions)]
        for action, *rest in self._statements:
            for each in range(num_actions) if action is None else action if isinstance(action, list) else (action,):
                by_action[each].append((rest[0], rest[1], rest[2], rest[3]))
        for action, statements in enumerate(by_action):
            if statements:
                matrix = observations[action] if observations is not None else None
                result[:, action] = self._action(statements, transitions[action], matrix)
        return result

    def _action(
        self, statements: list[tuple[Any, Any, Any, Any]], transition: Any, observation: Any
    ) -> npt.NDArray[np.float64]:
        num_states = self._shape[1]
        if all(n is None and o is None and isinstance(value, float) for _, n, o, value in statements):
            flat = np.zeros(num_states)
            for state, _, _, value in statements:
                flat[slice(None) if state is None else state] = value
            return flat
        over_observations = observation is not None and any(
            o is not None or np.ndim(value) > 0 for _, _, o, value in statements
        )
        width = num_states * (self._shape[2] if over_observations else 1)
        step = max(1, min(num_states, _LIMIT // width))
        # In blocks of states, so that the full S x S' x O array is never made for a large model.
        blocks = [
            self._block(
                statements, first, min(first + step, num_states), transition, observation if over_observations else None
            )
            for first in range(0, num_states, step)
        ]
        return np.concatenate(blocks)

    def _block(
        self, statements: list[tuple[Any, Any, Any, Any]], first: int, last: int, transition: Any, observation: Any
    ) -> npt.NDArray[np.float64]:
        num_states = self._shape[1]
        rows = transition[first:last]
        weights = rows if isinstance(rows, np.ndarray) else rows.toarray()
        everything = slice(None)
        if observation is None:
            values = np.zeros((last - first, num_states))
            for state, next_state, _, value in statements:
                if state is None or first <= state < last:
                    place = everything if state is None else state - first
                    part = value[first:last] if np.ndim(value) == 2 else value
                    values[place, everything if next_state is None else next_state] = part
            return np.asarray((weights * values).sum(axis=1))
        dense = observation if isinstance(observation, np.ndarray) else observation.toarray()
        cube = np.zeros((last - first, num_states, dense.shape[1]))
        for state, next_state, symbol, value in statements:
            if state is None or first <= state < last:
                place = everything if state is None else state - first
                cube[
                    place,
                    everything if next_state is None else next_state,
                    everything if symbol is None else symbol,
                ] = value
        return np.asarray(np.einsum("sn,no,sno->s", weights, dense, cube))
