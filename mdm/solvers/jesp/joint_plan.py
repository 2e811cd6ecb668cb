"""Joint plans: for each agent a tree that holds an action for every history of its own observations.

The exact value follows all joint histories that can occur, with the distribution over states that comes with each:
O(A^0 S^2 O^t) at step t at most, O being the joint observations.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mdm.errors import ModelError
from mdm.policies import FiniteStateController, JointController

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models.dynamics import Indices
    from mdm.solvers.jesp.team import Team

__all__ = ["MOST", "JointPlan", "Tree", "as_controller", "plan_size", "plan_value", "random_plan"]

Tree: TypeAlias = "list[Indices]"
"""One agent's actions: an array for each step, by the index of its history (row-major, the oldest first)."""
JointPlan: TypeAlias = "list[Tree]"
"""A tree per agent."""

MOST = 50_000_000
"""Numbers that one step of a computation may take: 400 MB."""


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
