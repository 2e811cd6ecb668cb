"""Joint plans: for each agent a tree that holds an action for every history of its own observations.

The exact value follows all joint histories that can occur, with the distribution over states that comes with each:
O(A^0 S^2 O^t) at step t at most, O being the joint observations. A `Team` is a Dec-POMDP for its agents.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics, Indices
from mdm.policies import FiniteStateController, JointController

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import POMDP
    from mdm.models.matrices import Vector

__all__ = ["MOST", "JointPlan", "Team", "Tree", "as_controller", "plan_size", "plan_value", "random_plan"]
MOST = 50_000_000
"""Numbers that one step of a computation may take: 400 MB."""


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


Tree: TypeAlias = "list[Indices]"
"""One agent's actions: an array for each step, by the index of its history (row-major, the oldest first)."""
JointPlan: TypeAlias = "list[Tree]"
"""A tree per agent."""


def plan_size(team: Team, horizon: int) -> int:
    """Return how many nodes the agents' trees have.

    Raises:
        ModelError: If there are too many to hold, or the horizon is no number of steps.
    """
    if horizon < 1:
        raise ModelError(f"a horizon is at least 1 decision, not {horizon}")
    nodes = 0
    for step in range(horizon):
        nodes += sum(symbols**step for symbols in team.observations)
        check_size(nodes, horizon)
    return nodes


def random_plan(team: Team, horizon: int, random: np.random.Generator) -> JointPlan:
    """Return a plan of actions drawn uniformly."""
    return [
        [random.integers(actions, size=symbols**step) for step in range(horizon)]
        for actions, symbols in zip(team.actions, team.observations, strict=True)
    ]


def plan_value(team: Team, plan: JointPlan) -> float:
    """Return the exact value of a plan at the initial belief.

    Raises:
        ModelError: If there are too many joint histories to follow.
    """
    horizon = len(plan[0])
    histories = np.zeros((1, team.num_agents), dtype=np.intp)
    reached = team.start[None, None, :]
    total, weight = 0.0, 1.0
    for step in range(horizon):
        actions = team.joint_actions([tree[step][histories[:, agent]] for agent, tree in enumerate(plan)])
        total += weight * float((reached[0] * team.rewards[actions]).sum())
        if step == horizon - 1:
            break
        check_size(reached.size * len(team.seen), horizon)
        after = team.advance(reached, actions).reshape(1, -1, team.num_states)
        possible = np.flatnonzero(after[0].any(axis=1))
        reached = after[:, possible]
        histories = lengthened(histories, team.seen, team.observations)[possible]
        weight *= team.discount
    return total


def lengthened(histories: Indices, seen: Indices, observations: Sequence[int]) -> Indices:
    """Return the histories (K x agents) that follow when each is continued by each joint observation: K O x agents."""
    longer = histories[:, None, :] * np.array(observations, dtype=np.intp) + seen[None]
    return longer.reshape(-1, longer.shape[2])


def check_size(size: int, horizon: int, most: int = MOST) -> None:
    """Refuse a computation that would take too much memory.

    Raises:
        ModelError: If it would.
    """
    if size > most:
        raise ModelError(
            f"a plan over {horizon} steps needs {size:,} numbers at once, more than {most:,}; take a shorter horizon"
        )


def as_controller(team: Team, plan: JointPlan) -> JointController:
    """Return a plan as controllers: each step's nodes follow those of the step before; nothing follows the last."""
    controllers = []
    for tree, count, symbols in zip(plan, team.actions, team.observations, strict=True):
        chosen: list[int] = []
        successors: list[Sequence[int | None]] = []
        for step, actions in enumerate(tree):
            chosen += actions.tolist()
            first = len(chosen)
            for history in range(len(actions)):
                begin = first + history * symbols
                successors.append([None] * symbols if step == len(tree) - 1 else range(begin, begin + symbols))
        controllers.append(FiniteStateController(chosen, successors, count))
    return JointController(controllers)
