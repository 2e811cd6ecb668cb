"""Sampling from a model: first states, transitions, observations; seeded."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

import numpy as np

from mdm.models import MDP, POMDP
from mdm.models.matrices import ROUNDING

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix

__all__ = ["Sampler"]

_Row = tuple[list[float], list[int]]


class Sampler:
    """Samples a model; the same seed gives the same samples.

    A sample costs a bisection of cumulative probabilities, which are computed once for each row that is visited.

    Args:
        model: The model.
        seed: The seed of the generator.

    Example::

        sampler = mdm.simulation.Sampler(mdm.problems.grid_world(slip=0.0), seed=1)
        state = sampler.first_state()
        state = sampler.next_state(state, 0)
    """

    def __init__(self, model: MDP, seed: int | None = None) -> None:
        self._model = model
        self._generator = np.random.default_rng(seed)
        self._numbers: list[float] = []
        self._first = _cumulative(model.initial_belief, np.arange(len(model.initial_belief)))
        self._transitions: dict[tuple[int, int], _Row] = {}
        self._observations: dict[tuple[int, ...], _Row] = {}

    def seed(self, seed: int | np.random.SeedSequence | None) -> None:
        """Restart the samples from a seed."""
        self._generator = np.random.default_rng(seed)
        self._numbers = []

    def _draw(self, row: _Row) -> int:
        if not self._numbers:
            self._numbers = self._generator.random(4096).tolist()
        levels, symbols = row
        return symbols[bisect_right(levels, self._numbers.pop())]

    def first_state(self) -> int:
        """Draw a state from the initial belief."""
        return self._draw(self._first)

    def next_state(self, state: int, action: int) -> int:
        """Draw the state that follows."""
        row = self._transitions.get((action, state))
        if row is None:
            row = self._transitions[action, state] = _row(self._model.transition_matrix(action), state)
        return self._draw(row)

    def observation(self, action: int, before: int, state: int) -> int | None:
        """Draw the observation after ``action`` has led from ``before`` to ``state``.

        Returns:
            The index; None for no observation, whose probability events may leave open.
        """
        model = self._model
        assert isinstance(model, POMDP)
        key = (action, before, state) if model.event_observations else (action, state)
        row = self._observations.get(key)
        if row is None:
            chances = model.observation(action, state, state=before)
            open_ = 1 - chances.sum() if model.event_observations else 0.0
            symbols = np.arange(len(chances) + 1)
            row = self._observations[key] = _cumulative(np.append(chances, open_ if open_ > ROUNDING else 0.0), symbols)
        drawn = self._draw(row)
        return drawn if drawn < len(model.observation_space) else None


def _row(matrix: Matrix, index: int) -> _Row:
    if isinstance(matrix, np.ndarray):
        return _cumulative(matrix[index], np.arange(matrix.shape[1]))
    begin, end = matrix.indptr[index], matrix.indptr[index + 1]
    return _cumulative(matrix.data[begin:end], matrix.indices[begin:end])


def _cumulative(probabilities: np.ndarray, symbols: np.ndarray) -> _Row:
    possible = probabilities > 0
    levels = np.cumsum(probabilities[possible])
    # The last level exceeds any number, so that rounding never draws past the end.
    levels[-1] = 2.0
    return levels.tolist(), symbols[possible].tolist()
