"""Joint policies of decentralised POMDPs: a controller per agent, each by its agent's own observations.

Source: D. S. Bernstein, R. Givan, N. Immerman and S. Zilberstein, *The complexity of decentralized control of Markov
decision processes*, Mathematics of Operations Research 27, 2002. A plan of finite horizon is a tree with a node per
history of observations.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from mdm.errors import ModelError
from mdm.policies.finite_state_controller import FiniteStateController
from mdm.policies.plan import Plan
from mdm.policies.policy import other_sizes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mdm.models import MDP
    from mdm.policies.policy import Arrays, Packed

__all__ = ["JointController"]

_MOST = 20_000
"""The largest number of joint nodes."""


class JointController(Plan):
    """A `FiniteStateController` per agent, each updated by its agent's own observations.

    Args:
        controllers: One per agent, in the agents' order, over that agent's own actions and observations.

    Raises:
        ModelError: If there is none.

    Example::

        listen = mdm.policies.FiniteStateController([0], [[0, 0]], num_actions=3)
        policy = mdm.policies.JointController([listen, listen])
        mdm.Controller(policy, mdm.problems.dec_tiger()).start().action_name  # 'listen listen'
    """

    kind: ClassVar[str] = "joint"
    form = "a finite-state controller per agent"

    def __init__(self, controllers: Iterable[FiniteStateController]) -> None:
        self._controllers = tuple(controllers)
        if not self._controllers:
            raise ModelError("a joint policy needs at least one agent's controller")

    @property
    def controllers(self) -> tuple[FiniteStateController, ...]:
        """The agents' controllers."""
        return self._controllers

    @property
    def num_agents(self) -> int:
        """The number of agents."""
        return len(self.controllers)

    @property
    def num_actions(self) -> int:  # type: ignore[override]
        """The number of joint actions."""
        return math.prod(controller.num_actions for controller in self.controllers)

    @property
    def num_states(self) -> None:  # type: ignore[override]
        """None: it has no values."""

    @property
    def start(self) -> tuple[int, ...]:
        """The agents' first nodes."""
        return tuple(controller.start for controller in self.controllers)

    @property
    def num_observations(self) -> int:  # type: ignore[override]
        """The number of joint observations."""
        return math.prod(controller.num_observations for controller in self.controllers)

    @property
    def horizon(self) -> int | None:  # type: ignore[override]
        """The number of decisions up to the end of the first agent's plan; None if no plan ends."""
        return min((each.horizon for each in self.controllers if each.horizon is not None), default=None)

    def actions_at(self, nodes: Sequence[int]) -> tuple[int, ...]:
        """Return each agent's own action at its node."""
        pairs = zip(self.controllers, self._per_agent(nodes, "nodes"), strict=True)
        return tuple(controller.action_at(node) for controller, node in pairs)

    def next_nodes(self, nodes: Sequence[int], observations: Sequence[int]) -> tuple[int | None, ...]:
        """Return each agent's next node after its own observation; None at the end of its plan."""
        seen = self._per_agent(observations, "observations")
        given = zip(self.controllers, self._per_agent(nodes, "nodes"), seen, strict=True)
        return tuple(controller.next_node(node, observation) for controller, node, observation in given)

    def _per_agent(self, given: Sequence[int], what: str) -> Sequence[int]:
        if len(given) != self.num_agents:
            raise ModelError(f"{len(given)} {what} are given for {self.num_agents} agents")
        return given

    def joined(self) -> FiniteStateController | None:
        """Return a single controller over joint actions and observations; None if it has more than 20,000 nodes.

        Its nodes are the reachable combinations of the agents' nodes.
        """
        actions = [controller.num_actions for controller in self.controllers]
        seen = list(itertools.product(*(range(controller.num_observations) for controller in self.controllers)))
        index = {self.start: 0}
        pending = [self.start]
        found: list[int] = []
        successors: list[list[int | None]] = []
        for nodes in pending:  # it grows meanwhile
            found.append(int(np.ravel_multi_index(self.actions_at(nodes), actions)))
            row: list[int | None] = []
            for observations in seen:
                after = self.next_nodes(nodes, observations)
                joint = tuple(node for node in after if node is not None)
                if len(joint) < len(after):
                    row.append(None)
                    continue
                if joint not in index:
                    if len(index) == _MOST:
                        return None
                    index[joint] = len(index)
                    pending.append(joint)
                row.append(index[joint])
            successors.append(row)
        return FiniteStateController(found, successors, self.num_actions)

    def mismatch(self, model: MDP) -> str | None:
        """Return why it does not fit a model, as a sentence; None if it fits."""
        if model.observation_space is None:
            return "the policy needs observations, but the model has none"
        if self.num_agents != model.num_agents:
            return f"the policy is for {self.num_agents} agents, but the model has {model.num_agents}"
        if len(model.observation_space.factors) != model.num_agents:
            return f"the model's observations need a factor for each of its {model.num_agents} agents"
        factors = zip(self.controllers, model.action_space.factors, model.observation_space.factors, strict=True)
        for agent, (controller, actions, observations) in enumerate(factors):
            ours, theirs = (controller.num_actions, controller.num_observations), (len(actions), len(observations))
            if ours != theirs:
                return f"agent {agent}: {other_sizes(ours, ('actions', 'observations'), theirs)}"
        return None

    def facts(self) -> dict[str, Any]:
        """Return its sizes by name."""
        nodes = [controller.num_nodes for controller in self.controllers]
        return {**super().facts(), "agents": self.num_agents, "nodes": nodes}

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        sizes: dict[str, int] = {"agents": self.num_agents}
        arrays: dict[str, Any] = {}
        for agent, controller in enumerate(self.controllers):
            own_sizes, own_arrays = controller.packed()
            sizes |= {f"agent{agent}_{name}": size for name, size in own_sizes.items()}
            arrays |= {f"agent{agent}_{name}": array for name, array in own_arrays.items()}
        return sizes, arrays

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""

        def own(agent: int, of: Mapping[str, Any]) -> dict[str, Any]:
            prefix = f"agent{agent}_"
            return {name.removeprefix(prefix): value for name, value in of.items() if name.startswith(prefix)}

        controllers = []
        for agent in range(sizes["agents"]):
            try:
                controllers.append(FiniteStateController.unpacked(own(agent, sizes), own(agent, arrays), seed))
            except KeyError as error:
                raise KeyError(f"agent{agent}_{error.args[0]}") from None
        return cls(controllers)
