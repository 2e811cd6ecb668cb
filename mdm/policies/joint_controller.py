"""Joint policies of teams whose members see no more than their own observations: a controller per agent.

Such are the solutions of decentralised POMDPs (D. S. Bernstein, R. Givan, N. Immerman and S. Zilberstein, *The
complexity of decentralized control of Markov decision processes*, Mathematics of Operations Research 27, 2002). The
plan of a finite horizon is a tree: a node per history of observations, and nothing after the last.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from mdm.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.policies.finite_state_controller import FiniteStateController

__all__ = ["JointController"]


class JointController:
    """A `FiniteStateController` per agent, each moved by its own agent's observations alone.

    Args:
        controllers: One per agent, in the agents' order; their actions and observations are that agent's own.

    Raises:
        ModelError: If there is none.
    """

    input: Literal["observation"] = "observation"

    def __init__(self, controllers: Iterable[FiniteStateController]) -> None:
        self.controllers = tuple(controllers)
        if not self.controllers:
            raise ModelError("a joint policy needs at least one agent's controller")

    @property
    def num_agents(self) -> int:
        """How many agents it is for."""
        return len(self.controllers)

    @property
    def num_actions(self) -> int:
        """How many joint actions there are."""
        return math.prod(controller.num_actions for controller in self.controllers)

    @property
    def num_states(self) -> None:
        """No number: it goes by observations and holds no values."""

    @property
    def start(self) -> tuple[int, ...]:
        """The agents' first nodes."""
        return tuple(controller.start for controller in self.controllers)

    @property
    def horizon(self) -> int | None:
        """How many decisions the team's plan has, which is over with the first agent's; None where none ends."""
        return min((each.horizon for each in self.controllers if each.horizon is not None), default=None)

    def actions_at(self, nodes: Sequence[int]) -> tuple[int, ...]:
        """Return each agent's own action at its node."""
        pairs = zip(self.controllers, self._per_agent(nodes, "nodes"), strict=True)
        return tuple(controller.action_at(node) for controller, node in pairs)

    def next_nodes(self, nodes: Sequence[int], observations: Sequence[int]) -> tuple[int | None, ...]:
        """Return each agent's next node after its own observation; None where its plan ends."""
        seen = self._per_agent(observations, "observations")
        given = zip(self.controllers, self._per_agent(nodes, "nodes"), seen, strict=True)
        return tuple(controller.next_node(node, observation) for controller, node, observation in given)

    def _per_agent(self, given: Sequence[int], what: str) -> Sequence[int]:
        if len(given) != self.num_agents:
            raise ModelError(f"{len(given)} {what} are given for {self.num_agents} agents")
        return given
