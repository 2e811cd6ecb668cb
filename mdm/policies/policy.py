"""What a policy is: a choice of action for a state, or for a belief."""

from __future__ import annotations

from typing import Any, Literal, Protocol, cast

from mdm.errors import ModelError

__all__ = ["Policy", "as_policy"]


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


def as_policy(given: Any) -> Policy:
    """Return what chooses by state or belief as it is.

    Raises:
        ModelError: If it is a controller, which goes from node to node by observations alone.
    """
    if given.input == "observation":
        raise ModelError(
            f"a {type(given).__name__} goes by observations, from node to node, and chooses for no state or belief; a "
            f"control layer needs a table, a Q-table or alpha vectors"
        )
    return cast("Policy", given)
