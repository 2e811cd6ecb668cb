"""Walks: controllers under way, from node to node by what is observed.

A step costs a look-up for each agent; no model is needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from mdm.errors import ModelError
from mdm.policies.finite_state_controller import FiniteStateController
from mdm.policies.joint_controller import JointController

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

__all__ = ["Controller", "Walk"]

Controller: TypeAlias = FiniteStateController | JointController


class Walk:
    """Where a controller is, or the controllers of a team together.

    The symbols of a team are joint, with the first agent the most significant; each agent's controller moves by that
    agent's part of the observation alone.

    Args:
        controller: What is run.
    """

    def __init__(self, controller: Controller) -> None:
        self._controllers = controller.controllers if isinstance(controller, JointController) else (controller,)
        self._action_counts = [each.num_actions for each in self._controllers]
        self._observation_counts = [each.num_observations for each in self._controllers]
        self._nodes = [each.start for each in self._controllers]

    @property
    def num_observations(self) -> int:
        """How many (joint) observations it moves by."""
        return math.prod(self._observation_counts)

    @property
    def nodes(self) -> tuple[int, ...]:
        """The present node of each controller; set them to go on from elsewhere."""
        return tuple(self._nodes)

    @nodes.setter
    def nodes(self, nodes: tuple[int, ...]) -> None:
        self._nodes = list(nodes)

    @property
    def action(self) -> int:
        """The (joint) action of the present nodes."""
        action = 0
        for controller, count, node in zip(self._controllers, self._action_counts, self._nodes, strict=True):
            action = action * count + controller.actions[node]
        return action

    @property
    def ended(self) -> bool:
        """Whether the present action is the last: some agent's plan goes on after no observation."""
        return any(map(FiniteStateController.is_last, self._controllers, self._nodes))

    def reset(self, belief: npt.NDArray[np.float64] | None = None) -> None:
        """Begin again, at the node that is best for a belief where one is given.

        Raises:
            ModelError: If a belief is given, but some node's value is not known; the nodes stay as they were.
        """
        self._nodes = [
            controller.start if belief is None else controller.start_node(belief) for controller in self._controllers
        ]

    def move(self, observation: int | tuple[int | None, ...] | None) -> bool:
        """Follow what was observed after the present action.

        Args:
            observation: The (joint) observation's index; or a component per agent, None where that agent observed
                nothing; or None where nobody did. Who observed nothing stays at its node.

        Returns:
            Whether every agent's controller has an edge for it; those that have none stay at their nodes.

        Raises:
            ModelError: If there is no such observation; the nodes stay as they were.
        """
        if observation is None:
            return True
        parts = observation if isinstance(observation, tuple) else self._parts(observation)
        if len(parts) != len(self._controllers):
            raise ModelError(f"an observation has {len(self._controllers)} components, not {len(parts)}")
        moves = zip(self._controllers, self._nodes, parts, strict=True)
        after = [node if part is None else controller.next_node(node, part) for controller, node, part in moves]
        self._nodes = [node if later is None else later for node, later in zip(self._nodes, after, strict=True)]
        return None not in after

    def _parts(self, observation: int) -> tuple[int, ...]:
        if not 0 <= observation < self.num_observations:
            raise ModelError(
                f"there is no observation {observation}; the controller's {self.num_observations} count from 0"
            )
        parts: list[int] = []
        for count in reversed(self._observation_counts):
            observation, part = divmod(observation, count)
            parts.append(part)
        return tuple(reversed(parts))
