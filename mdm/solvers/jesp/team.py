"""A Dec-POMDP as its agents take it: steps of joint beliefs, and what each agent has of a joint symbol."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.compressed import is_compressed

if TYPE_CHECKING:
    from mdm.models import POMDP
    from mdm.models.matrices import Matrix, Vector

__all__ = ["Indices", "Team"]

Indices: TypeAlias = npt.NDArray[np.intp]


class Team:
    """The dynamics of a team's model.

    Args:
        model: A POMDP with as many factors of observations as agents.
        as_one: Take the agents for one that sees all that they observe and decides for all (the MPOMDP).

    Raises:
        ModelError: If observations are not one for each agent, or events leave a part to no observation.
    """

    def __init__(self, model: POMDP, *, as_one: bool = False) -> None:
        model = model.flatten()
        if len(model.observation_space.factors) != model.num_agents:
            raise ModelError(
                f"agents of a team decide by their own observations, but the model has "
                f"{len(model.observation_space.factors)} factors of observations for {model.num_agents} agents"
            )
        self.actions = (len(model.action_space),) if as_one else model.action_space.shape
        self.observations = (len(model.observation_space),) if as_one else model.observation_space.shape
        self.num_agents = len(self.actions)
        self.num_states = len(model.state_space)
        self.discount = model.discount
        self.start: Vector = model.initial_belief
        self.rewards: Vector = np.ascontiguousarray(model.rewards.T)  # A x S
        """R(s, a) of the joint actions, A x S."""
        self.seen: Indices = np.stack(np.unravel_index(np.arange(math.prod(self.observations)), self.observations), 1)
        """The agents' parts of the joint observations, O x agents."""
        joint_actions = range(len(model.action_space))
        self._transitions = [model.transition_matrix(action) for action in joint_actions]
        self._chances: list[Vector] = []
        self._joints: list[list[Matrix]] = []
        if model.event_observations:
            observed = range(len(model.observation_space))
            self._joints = [[model.joint_matrix(action, o) for o in observed] for action in joint_actions]
            for action, joints in enumerate(self._joints):
                total = sum(np.asarray(joint.sum(axis=1)).ravel() for joint in joints)
                if np.abs(total - 1).max() > 1e-6:
                    raise ModelError(
                        f"action {model.action_space.names[action]!r} may lead to no observation at all; a joint plan "
                        f"is for agents that observe something at each step"
                    )
        else:
            self._chances = [_dense(model.observation_matrix(action)).T for action in joint_actions]

    def joint_actions(self, own: list[Indices] | list[Indices | int]) -> Indices:
        """Return the indices of joint actions, of the agents' own."""
        return np.ravel_multi_index(tuple(np.broadcast_arrays(*own)), self.actions)

    def step(self, action: int, beliefs: Vector) -> Vector:
        """Return P(o, s') for each of n distributions over states (n x S): n x O x S'."""
        if self._joints:
            return np.stack([np.asarray(beliefs @ joint) for joint in self._joints[action]], axis=1)
        after: Vector = np.asarray(beliefs @ self._transitions[action])
        return after[:, None, :] * self._chances[action]

    def advance(self, beliefs: Vector, actions: Indices) -> Vector:
        """Step N x K distributions over states (N x K x S), those of a column by its joint action: N x K x O x S'."""
        count, columns, size = beliefs.shape
        result = np.empty((count, columns, len(self.seen), size))
        for action in np.unique(actions):
            taken = np.flatnonzero(actions == action)
            result[:, taken] = self.step(int(action), beliefs[:, taken].reshape(-1, size)).reshape(
                count, len(taken), -1, size
            )
        return result

    def known_states_value(self, horizon: int) -> float:
        """Return what a team that always knew the state would be worth: more than any plan is."""
        values = np.zeros(self.num_states)
        for _ in range(horizon):
            after = np.stack([np.asarray(transition @ values) for transition in self._transitions])
            values = (self.rewards + self.discount * after).max(axis=0)
        return float(self.start @ values)


def _dense(matrix: Matrix) -> Vector:
    return np.asarray(matrix.toarray()) if is_compressed(matrix) else np.asarray(matrix)
