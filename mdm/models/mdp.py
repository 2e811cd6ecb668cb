"""Markov decision processes, for one agent or a team (MMDP), as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import Matrix, Vector, distribution, numbers, read_only, stochastic_matrices
from mdm.models.space import Space

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Self

    import numpy.typing as npt

__all__ = ["MDP"]


class MDP:
    """A Markov decision process: states, actions, transition probabilities, expected rewards.

    Args:
        transitions: P(s' | s, a): an A x S x S array, or one S x S matrix per action, dense or sparse.
        rewards: R(s, a): S x A, the expected immediate reward.
        discount: In (0, 1].
        states: Their names, how many there are, or a `Space`; by default counted.
        actions: The same; a `Space` with one factor per agent makes a team.
        initial_belief: The distribution of the first state (S numbers); uniform by default.
        sparse: Force CSR or dense matrices; None chooses by size and density.

    Raises:
        ModelError: If shapes do not fit or numbers are no probabilities.
    """

    kind: Literal["MDP", "POMDP"] = "MDP"

    def __init__(
        self,
        transitions: Sequence[Any] | npt.NDArray[np.float64],
        rewards: npt.ArrayLike,
        *,
        discount: float,
        states: Space | Iterable[str] | int | None = None,
        actions: Space | Iterable[str] | int | None = None,
        initial_belief: npt.ArrayLike | None = None,
        sparse: bool | None = None,
    ) -> None:
        expected = numbers(rewards, "the array of rewards")
        if expected.ndim != 2 or 0 in expected.shape:
            raise ModelError(f"the rewards are a states x actions array, not one of shape {expected.shape}")
        self.state_space = as_space("state", states, expected.shape[0])
        self.action_space = as_space("agent", actions, expected.shape[1])
        if expected.shape != (len(self.state_space), len(self.action_space)):
            raise ModelError(
                f"the rewards are {expected.shape[0]} x {expected.shape[1]}, but there are {len(self.state_space)} "
                f"states and {len(self.action_space)} actions"
            )
        if not np.isfinite(expected).all():
            state, action = (int(place[0]) for place in np.nonzero(~np.isfinite(expected)))
            raise ModelError(
                f"the reward of action {self.action_space.names[action]!r} in state "
                f"{self.state_space.names[state]!r} is {expected[state, action]}, not a finite number"
            )
        if not 0 < discount <= 1:
            raise ModelError(f"a discount is more than 0 and at most 1, not {discount:g}")
        self.rewards: Vector = read_only(expected)
        self.discount = float(discount)
        self._transitions = stochastic_matrices(
            transitions,
            what="T",
            actions=self.action_space,
            rows=self.state_space,
            columns=len(self.state_space),
            sparse_=sparse,
        )
        count = len(self.state_space)
        self.initial_belief = distribution(
            np.full(count, 1 / count) if initial_belief is None else initial_belief, what="the start", size=count
        )

    @property
    def num_agents(self) -> int:
        """How many agents act: one per factor of the action space."""
        return len(self.action_space.factors)

    @property
    def is_sparse(self) -> bool:
        """Whether its matrices are CSR."""
        return not isinstance(self._transitions[0], np.ndarray)

    def transition_matrix(self, action: int | str) -> Matrix:
        """Return P(s' | s, a) as an S x S' matrix, read-only."""
        return self._transitions[self.action_space.index(action)]

    def with_discount(self, discount: float) -> Self:
        """Return the same model with another discount."""
        if not 0 < discount <= 1:
            raise ModelError(f"a discount is more than 0 and at most 1, not {discount:g}")
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other.discount = float(discount)
        return other

    def __repr__(self) -> str:
        return f"<{self.kind}: {len(self.state_space)} states, {len(self.action_space)} actions>"


def as_space(name: str, given: Space | Iterable[str] | int | None, count: int) -> Space:
    """Return the space that names, a number, or nothing stand for."""
    if isinstance(given, Space):
        return given
    return Space.single(name, count if given is None else given)
