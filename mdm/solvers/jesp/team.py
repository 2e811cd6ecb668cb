"""A Dec-POMDP for its agents: the dynamics, and the agents' components of joint symbols."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics, Indices

if TYPE_CHECKING:
    from mdm.models import POMDP
    from mdm.models.matrices import Vector

__all__ = ["Team"]


class Team:
    """A team's model.

    Args:
        model: A POMDP with as many factors of observations as agents.
        as_one: Take the agents as one that observes and decides for all (the MPOMDP).

    Raises:
        ModelError: If there is not one observation for each agent, or an event may be without an observation.
    """

    def __init__(self, model: POMDP, *, as_one: bool = False) -> None:
        if len(model.observation_space.factors) != model.num_agents:
            raise ModelError(
                f"agents of a team decide by their own observations, but the model has "
                f"{len(model.observation_space.factors)} factors of observations for {model.num_agents} agents"
            )
        self.dynamics = dynamics = Dynamics(model)
        self.actions = (len(model.action_space),) if as_one else model.action_space.shape
        self.observations = (len(model.observation_space),) if as_one else model.observation_space.shape
        self.num_agents = len(self.actions)
        self.num_states = dynamics.num_states
        self.discount = dynamics.discount
        self.start: Vector = model.initial_belief
        self.rewards: Vector = np.ascontiguousarray(dynamics.rewards.T)
        """R(s, a) of the joint actions, A x S."""
        self.seen: Indices = np.stack(np.unravel_index(np.arange(math.prod(self.observations)), self.observations), 1)
        """The agents' components of the joint observations, O x agents."""
        for action, name in enumerate(model.action_space.names if dynamics.by_transition else ()):
            total = dynamics.step(action, np.eye(self.num_states)).sum(axis=(1, 2))
            if np.abs(total - 1).max() > 1e-6:
                raise ModelError(
                    f"action {name!r} may lead to no observation at all; a joint plan is for agents that observe "
                    f"something at each step"
                )

    def joint_actions(self, own: list[Indices] | list[Indices | int]) -> Indices:
        """Return the indices of joint actions, of the agents' own."""
        return np.ravel_multi_index(tuple(np.broadcast_arrays(*own)), self.actions)

    def advance(self, beliefs: Vector, actions: Indices) -> Vector:
        """Step N x K distributions over states (N x K x S), those of a column by its joint action: N x K x O x S'."""
        count, columns, size = beliefs.shape
        result = np.empty((count, columns, len(self.seen), size))
        for action in np.unique(actions):
            taken = np.flatnonzero(actions == action)
            result[:, taken] = self.dynamics.step(int(action), beliefs[:, taken].reshape(-1, size)).reshape(
                count, len(taken), -1, size
            )
        return result
