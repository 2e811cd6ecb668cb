"""Partially observable Markov decision processes, for one agent or a team (MPOMDP), as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from mdm.errors import ModelError
from mdm.models.compressed import is_compressed
from mdm.models.matrices import Matrix, numbers, stochastic_matrices
from mdm.models.mdp import MDP, as_space

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    import numpy.typing as npt

    from mdm.models.space import Space

__all__ = ["POMDP"]


class POMDP(MDP):
    """A partially observable Markov decision process: an `MDP` whose state shows in observations alone.

    Args:
        transitions: As for `MDP`.
        observations: P(o | a, s'): an A x S' x O array, or one S' x O matrix per action, dense or sparse.
        rewards: As for `MDP`, as are the other arguments.
        observation_names: Names of the observations, how many there are, or a `Space` with a factor per agent.

    Raises:
        ModelError: If shapes do not fit or numbers are no probabilities.
    """

    kind: Literal["MDP", "POMDP"] = "POMDP"

    def __init__(
        self,
        transitions: Sequence[Any] | npt.NDArray[np.float64],
        observations: Sequence[Any] | npt.NDArray[np.float64],
        rewards: npt.ArrayLike,
        *,
        discount: float,
        states: Space | Iterable[str] | int | None = None,
        actions: Space | Iterable[str] | int | None = None,
        observation_names: Space | Iterable[str] | int | None = None,
        initial_belief: npt.ArrayLike | None = None,
        sparse: bool | None = None,
    ) -> None:
        super().__init__(
            transitions,
            rewards,
            discount=discount,
            states=states,
            actions=actions,
            initial_belief=initial_belief,
            sparse=sparse,
        )
        first: Any = observations[0] if len(observations) else ()
        shape = first.shape if is_compressed(first) else numbers(first, "the first matrix of observations").shape
        if len(shape) != 2 or 0 in shape:
            raise ModelError("observations are an actions x states x observations array, or a matrix per action")
        self.observation_space = as_space("agent", observation_names, shape[1])
        self._observations = stochastic_matrices(
            observations,
            what="O",
            actions=self.action_space,
            rows=self.state_space,
            columns=len(self.observation_space),
            sparse_=sparse,
        )

    def observation_matrix(self, action: int | str) -> Matrix:
        """Return P(o | a, s') as an S' x O matrix, read-only."""
        return self._observations[self.action_space.index(action)]

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, {len(self.observation_space)} observations>"
