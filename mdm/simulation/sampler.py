"""Sampling from a model: first states, transitions, observations and how long actions take; seeded.

A `Sampler` draws for one episode at a time, a `BatchSampler` for many at once, without a loop over them.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models import MDP, Durations
from mdm.models.availability import refuse
from mdm.models.dynamics import Dynamics, Indices, Rows, stacked
from mdm.models.matrices import ROUNDING
from mdm.models.units import seconds_in

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector

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

    def seed(self, seed: int | np.random.SeedSequence | np.random.Generator | None) -> None:
        """Restart the samples from a seed, or draw them from a generator of another's from now on."""
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
            refuse(self._model, state, action)
            matrix = self._model.transition_matrix(action)
            if isinstance(matrix, np.ndarray):
                row = _cumulative(matrix[state], np.arange(matrix.shape[1]))
            else:
                begin, end = matrix.indptr[state], matrix.indptr[state + 1]
                row = _cumulative(matrix.data[begin:end], matrix.indices[begin:end])
            self._transitions[action, state] = row
        return self._draw(row)

    def observation(self, action: int, before: int, state: int) -> int | None:
        """Draw the observation after ``action`` has led from ``before`` to ``state``.

        Returns:
            The index; None for no observation, whose probability events may leave open.
        """
        model = self._model.pomdp
        assert model is not None
        key = (action, before, state) if model.event_observations else (action, state)
        row = self._observations.get(key)
        if row is None:
            chances = model.observation(action, state, state=before)
            open_ = 1 - chances.sum() if model.event_observations else 0.0
            symbols = np.arange(len(chances) + 1)
            row = self._observations[key] = _cumulative(np.append(chances, open_ if open_ > ROUNDING else 0.0), symbols)
        drawn = self._draw(row)
        return drawn if drawn < len(model.observation_space) else None


def _cumulative(probabilities: np.ndarray, symbols: np.ndarray) -> _Row:
    possible = probabilities > 0
    levels = np.cumsum(probabilities[possible])
    # The last level exceeds any number, so that rounding never draws past the end.
    levels[-1] = 2.0
    return levels.tolist(), symbols[possible].tolist()


class BatchSampler:
    """Draws first states, and next states with observations.

    Args:
        model: The model.
        observed: Whether observations are drawn; policies over states need none.
    """

    def __init__(self, model: MDP, *, observed: bool = True) -> None:
        dynamics = Dynamics(model)
        self.rewards = dynamics.rewards
        self.ended = ended_states(dynamics)
        """The states without further rewards, where an episode ends."""
        self.nothing = dynamics.num_observations
        """The index that stands for no observation."""
        self._first = Draws(stacked([model.initial_belief[None, :]]))
        self._transitions = Draws(dynamics.transitions)
        self._model = model
        self._by_transition = dynamics.by_transition
        self._observations = Draws(dynamics.observations) if observed and dynamics.num_observations else None

    def first(self, numbers: Vector) -> Indices:
        """Draw first states, one for each number from [0, 1)."""
        zeros = np.zeros(len(numbers), dtype=np.intp)
        return self._first.columns[self._first(zeros, zeros, numbers)]

    def move(self, states: Indices, actions: Indices, numbers: Vector) -> tuple[Indices, Indices]:
        """Draw next states and observations.

        Args:
            states: The states of E episodes.
            actions: Their actions.
            numbers: From [0, 1), 2 x E: for the transitions, and for the observations.

        Returns:
            The next states and the observations; ``nothing`` for an event without one.
        """
        if self._model.available is not None:
            for at in np.flatnonzero(~self._model.available[states, actions]):
                refuse(self._model, int(states[at]), int(actions[at]))
        entries = self._transitions(actions, states, numbers[0])
        after = self._transitions.columns[entries]
        draws = self._observations
        if draws is None:
            return after, np.zeros_like(after)
        rows = entries - self._transitions.first_entry[actions] if self._by_transition else after
        return after, draws.columns[draws(actions, rows, numbers[1])]


class Draws:
    """Rows as distributions to draw from.

    A draw finds an entry by bisection of the row's cumulative probabilities, for all rows at once.

    Args:
        rows: Rows that sum to 1.
    """

    def __init__(self, rows: Rows) -> None:
        self._first_row = rows.first
        self._starts = rows.starts.astype(np.intp)
        self.first_entry: Indices = self._starts[rows.first]
        """The first entry of each action's rows."""
        self.columns: Indices = rows.columns.astype(np.intp)
        """The column of each entry."""
        self._levels = _levels(rows, self._starts)
        self._rounds = int(np.diff(self._starts).max() - 1).bit_length()

    def __call__(self, actions: Indices, rows: Indices, numbers: Vector) -> Indices:
        """Draw an entry from a row for each number.

        Args:
            actions: The actions.
            rows: A row of each action's.
            numbers: From [0, 1).
        """
        at = self._first_row[actions] + rows
        low: Indices = self._starts[at]
        high = self._starts[at + 1] - 1
        for _ in range(self._rounds):
            middle = (low + high) >> 1
            beyond = self._levels[middle] <= numbers
            low = np.where(beyond, middle + 1, low)
            high = np.where(beyond, high, middle)
        return low


def _levels(rows: Rows, starts: Indices) -> Vector:
    """Return the cumulative probabilities of each row; the last exceeds any number, in spite of rounding."""
    levels = np.empty(len(rows.values))
    blocks = np.append(np.unique(rows.first), len(starts) - 1)
    for begin, end in pairwise(blocks):  # sums over all would lose digits
        own = starts[begin : end + 1]
        total = np.cumsum(rows.values[own[0] : own[-1]])
        before = np.concatenate(([0.0], total))[own[:-1] - own[0]]
        levels[own[0] : own[-1]] = total - np.repeat(before, np.diff(own))
    levels[starts[1:] - 1] = 2.0
    return levels


def ended_states(dynamics: Dynamics, rewards: Vector | None = None) -> npt.NDArray[np.bool_]:
    """Return the states from which no reward can be reached: the model's, or one of others, S x actions."""
    size = dynamics.num_states
    earning = np.flatnonzero(((dynamics.rewards if rewards is None else rewards) != 0).any(axis=1))
    ended = np.zeros(size, dtype=bool)
    if len(earning) == size:
        return ended
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import breadth_first_order  # noqa: PLC0415

    # A backward search from an additional node, which precedes all states with rewards.
    ways = dynamics.transitions.matrix(size).tocoo()
    rows = np.concatenate([ways.col, np.full(len(earning), size)])
    columns = np.concatenate([ways.row % size, earning])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size + 1, size + 1)).tocsr()
    ended[:] = True
    found = breadth_first_order(graph, size, return_predecessors=False)
    ended[found[found < size]] = False
    return ended


class Lengths:
    """Draws how long actions take; the same seed gives the same lengths.

    Args:
        model: The model that the durations are for.
        durations: Their distributions.
        seed: The seed of the draws, which are not those of a `Sampler` of the same seed.

    Raises:
        ModelError: If the durations are none, or for other numbers of states or actions.
    """

    def __init__(self, model: MDP, durations: Durations, seed: int | None = None) -> None:
        if not isinstance(durations, Durations):
            raise ModelError(f"durations are mdm.models.Durations(…), not {durations!r}")
        means, stages = durations.table(model)
        if durations.of == "step":
            means = means * (seconds_in(model.discount_of) or 1.0)
        self._means, self._stages = means.tolist(), stages.tolist()
        self._generator = np.random.default_rng(None if seed is None else [seed, 1])

    def draw(self, state: int, action: int) -> float:
        """Draw the seconds that an action takes in a state."""
        stages = self._stages[state][action]
        return float(self._generator.gamma(stages, self._means[state][action] / stages))
