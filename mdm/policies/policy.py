"""What a policy is: a choice of action for a state, or for a belief."""

from __future__ import annotations

from typing import Any, Literal, Protocol

__all__ = ["Policy"]


class Policy(Protocol):
    """Chooses actions; implement it to bring a policy of your own.

    Attributes:
        input: What it chooses by: a ``state`` index (MDP) or a ``belief``, an array of S numbers (POMDP).
        num_states: S.
        num_actions: How many (joint) actions there are.
    """

    @property
    def input(self) -> Literal["state", "belief"]:
        """What it chooses by."""
        ...

    @property
    def num_states(self) -> int:
        """How many states it is for."""
        ...

    @property
    def num_actions(self) -> int:
        """How many actions it chooses among."""
        ...

    def action(self, x: Any, /) -> int:
        """Return the action for a state index or a belief."""
        ...

    def value(self, x: Any, /) -> float:
        """Return the expected discounted return from a state index or a belief."""
        ...
