"""The worlds of many episodes, moved together: states as an array, a step of all of them in a few array operations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models import MDP, POMDP
from mdm.models.compressed import csr
from mdm.models.events import by_entry
from mdm.simulation.draws import Draws

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

__all__ = ["Crowd", "Indices"]

Indices = Any
"""An array of whole numbers."""


class Crowd:
    """Draws first states, and next states with observations, for many episodes of a model at once.

    Args:
        model: The model.
        observed: Whether observations are drawn; what decides by the state needs none.
    """

    def __init__(self, model: MDP, *, observed: bool = True) -> None:
        actions = range(len(model.action_space))
        self._first = Draws([model.initial_belief[None, :]])
        matrices = [model.transition_matrix(a) for a in actions]
        self._transitions = Draws(matrices)
        self.rewards = model.rewards
        self.ended = _ended(matrices, model.rewards)
        """The states from which nothing more can be earned: an episode that is there is over."""
        self._observations: Draws | None = None
        self._by_transition = False
        if observed and isinstance(model, POMDP):
            self._by_transition = model.event_observations
            if model.events is not None:
                self._observations = Draws([by_entry(model.events, a, matrices[a]) for a in actions])
            else:
                self._observations = Draws([model.observation_matrix(a) for a in actions])
        self.nothing: int = len(model.observation_space) if isinstance(model, POMDP) else 0
        """What is drawn where nothing is observed: no observation's index."""

    def first(self, numbers: Vector) -> Indices:
        """Draw first states, one for each number from [0, 1)."""
        zeros = np.zeros(len(numbers), dtype=np.intp)
        return self._first.columns[self._first(zeros, zeros, numbers)]

    def move(self, states: Indices, actions: Indices, numbers: Vector) -> tuple[Indices, Indices]:
        """Draw what follows.

        Args:
            states: E of them.
            actions: Of each episode.
            numbers: From [0, 1), 2 x E: for the transitions, and for the observations.

        Returns:
            The next states, and what is observed; ``nothing`` where events leave it open.
        """
        entries = self._transitions(actions, states, numbers[0])
        after = self._transitions.columns[entries]
        draws = self._observations
        if draws is None:
            return after, np.zeros_like(after)
        rows = entries - self._transitions.first_entry[actions] if self._by_transition else after
        return after, draws.columns[draws(actions, rows, numbers[1])]


def _ended(matrices: Sequence[Matrix], rewards: Vector) -> npt.NDArray[np.bool_]:
    """Return from which states no action ever leads to a reward."""
    size = len(rewards)
    earning = np.flatnonzero((rewards != 0).any(axis=1))
    ended = np.zeros(size, dtype=bool)
    if len(earning) == size:
        return ended
    from scipy.sparse import coo_array  # noqa: PLC0415 - as long to import as all the rest
    from scipy.sparse.csgraph import breadth_first_order  # noqa: PLC0415

    # Backwards, from one more node that stands before all states with rewards.
    ways = [csr(matrix).tocoo() for matrix in {id(matrix): matrix for matrix in matrices}.values()]
    rows = np.concatenate([*(way.col for way in ways), np.full(len(earning), size)])
    columns = np.concatenate([*(way.row for way in ways), earning])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size + 1, size + 1)).tocsr()
    ended[:] = True
    found = breadth_first_order(graph, size, return_predecessors=False)
    ended[found[found < size]] = False
    return ended
