"""Plans: policies over the nodes of finite-state controllers, and the progress of one.

A step costs a look-up per agent, and needs no model.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import distribution
from mdm.policies.batch import ENDED
from mdm.policies.policy import Kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models import MDP, POMDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch, Indices
    from mdm.policies.finite_state_controller import FiniteStateController

__all__ = ["Plan", "Walk"]


class Plan(Kind):
    """The base of finite-state controllers: a single one, or one per agent."""

    input: Literal["observation"] = "observation"
    num_observations: int

    @property
    def controllers(self) -> tuple[FiniteStateController, ...]:
        """The controllers, one per agent."""
        raise NotImplementedError

    def information(self, model: MDP | None) -> Walk:
        """Return the first nodes."""
        known = model is not None and self.num_states is not None
        return Walk(self.controllers, model.initial_belief if known and model is not None else None)

    def action(self, nodes: Sequence[int]) -> int:
        """Return the (joint) action at the node of each controller."""
        action = 0
        for controller, node in zip(self.controllers, nodes, strict=True):
            action = action * controller.num_actions + controller.actions[node]
        return action

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        return None if model.pomdp is None else PlanBatch(self.controllers, model.pomdp)


class Walk:
    """The present node of each controller: the `Information` of a plan, without a belief.

    The symbols of a team are joint, with the first agent the most significant. Each controller is updated by its
    agent's own component. If the nodes have values, the first node is the best one at a given or the initial belief.

    Args:
        controllers: One per agent.
        initial: The initial belief.
    """

    belief: None = None
    expected: None = None

    def __init__(self, controllers: Sequence[FiniteStateController], initial: Vector | None = None) -> None:
        self._controllers = tuple(controllers)
        self._counts = tuple(each.num_observations for each in self._controllers)
        self._initial = initial
        self.current: tuple[int, ...] = ()
        self.reset()

    @property
    def ended(self) -> bool:
        """Whether the present action is the last: the node of some agent has no successors."""
        return any(each.is_last(node) for each, node in zip(self._controllers, self.current, strict=True))

    @property
    def impossible(self) -> str:
        """Why an observation is impossible, in words."""
        return f"has no edge at the nodes {self.current}"

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin at the first nodes.

        Raises:
            ModelError: If a belief is given, but the nodes have no values for it; the nodes stay as they were.
        """
        given = self._initial if belief is None else belief
        if given is None:
            self.current = tuple(each.start for each in self._controllers)
            return
        size = self._controllers[0].num_states
        if size is None or len(self._controllers) > 1:
            raise ModelError("the controller's nodes have no values: it cannot begin from a belief")
        self.current = (self._controllers[0].start_node(distribution(given, what="the belief", size=size)),)

    def update(self, action: int | None, observation: int | tuple[int | None, ...] | frozenset[int] | None) -> float:
        """Follow the edges of an observation.

        Args:
            action: Ignored: the nodes determine it.
            observation: The index of the (joint) observation; or a component per agent, with None for a missing one;
                or None for no observation. Without an observation an agent stays at its node.

        Returns:
            1; or 0 if a controller has no edge for the observation, and stays at its node.

        Raises:
            ModelError: If there is no such observation; the nodes are unchanged.
        """
        if observation is None:
            return 1.0
        if isinstance(observation, frozenset):
            raise ModelError("a plan has an edge for each whole observation: it cannot go by a part of one")
        if not isinstance(observation, tuple):
            total = int(np.prod(self._counts))
            if not 0 <= observation < total:
                raise ModelError(f"there is no observation {observation}; the controller's {total} count from 0")
            observation = tuple(int(part) for part in np.unravel_index(observation, self._counts))
        if len(observation) != len(self._controllers):
            raise ModelError(f"an observation has {len(self._controllers)} components, not {len(observation)}")
        moves = zip(self._controllers, self.current, observation, strict=True)
        after = [node if part is None else controller.next_node(node, part) for controller, node, part in moves]
        self.current = tuple(node if later is None else later for node, later in zip(self.current, after, strict=True))
        return 0.0 if None in after else 1.0

    def snapshot(self) -> Any:
        """Return the nodes."""
        return list(self.current)

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot.

        Raises:
            ModelError: If a node is none of its controller; the nodes are unchanged.
        """
        nodes = tuple(operator.index(node) for node in snapshot)
        for controller, node in zip(self._controllers, nodes, strict=True):
            if not 0 <= node < controller.num_nodes:
                raise ModelError(f"there is no node {node}; the controller's {controller.num_nodes} count from 0")
        self.current = nodes


class PlanBatch:
    """The nodes of a batch of episodes, one per episode and agent.

    Args:
        controllers: One per agent.
        model: The model.
    """

    def __init__(self, controllers: Sequence[FiniteStateController], model: POMDP) -> None:
        self._controllers = tuple(controllers)
        self._model = model
        team = len(self._controllers) > 1
        self._shape = model.action_space.shape if team else (len(model.action_space),)
        self._seen = model.observation_space.shape if team else (len(model.observation_space),)
        self._actions = [np.array(controller.actions) for controller in self._controllers]
        self._successors = [
            np.array([[ENDED if node is None else node for node in row] for row in controller.successors])
            for controller in self._controllers
        ]
        self._nodes = np.empty((len(self._controllers), 0), dtype=np.intp)

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions."""
        alone = self._controllers[0] if len(self._controllers) == 1 else None
        if alone is not None and alone.values is not None:  # begin at the best node for the initial belief
            first, inverse = np.unique(states, return_inverse=True)
            nodes = np.array([alone.start_node(self._model.belief_at_start(int(state))) for state in first])
            self._nodes = nodes[None, inverse]
        else:
            starts = np.array([controller.start for controller in self._controllers])
            self._nodes = np.repeat(starts[:, None], len(states), axis=1)
        return self._at(self._nodes)

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions."""
        parts = np.unravel_index(seen, self._seen)
        for agent, (successors, part) in enumerate(zip(self._successors, parts, strict=True)):
            self._nodes[agent, episodes] = successors[self._nodes[agent, episodes], part]
        nodes = self._nodes[:, episodes]
        return np.where((nodes == ENDED).any(axis=0), ENDED, self._at(nodes))

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Drop the other episodes' nodes."""
        self._nodes = self._nodes[:, which]

    def _at(self, nodes: Indices) -> Indices:
        parts = [actions[row] for actions, row in zip(self._actions, nodes, strict=True)]
        joint: Indices = np.ravel_multi_index(parts, self._shape)
        return joint
