"""The best response of one agent to the plans of the others, by dynamic programming over its reachable beliefs.

With the others' plans fixed, the agent faces a POMDP whose states are the world's together with the others' histories.
Its reachable beliefs are followed forward, equal ones once, and their values computed backward (R. Nair, M. Tambe,
M. Yokoo, D. Pynadath and S. Marsella, *Taming decentralized POMDPs: towards efficient policy computation for multiagent
settings*, IJCAI 2003, DP-JESP). At step t there are at most (A_i O_i)^t beliefs, each of S numbers for each of the
others' joint histories. For a team taken as one agent this is the exact solution of the MPOMDP.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.errors import ModelError
from mdm.solvers.jesp.joint_plan import MOST, check_size, lengthened

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models.dynamics import Indices
    from mdm.models.matrices import Vector
    from mdm.solvers.jesp.joint_plan import JointPlan, Team, Tree

__all__ = ["Stage", "best_response", "merged", "solve_as_one"]

_DIGITS = 12
"""Beliefs that agree to so many digits are one."""
_AS_ONE = 4_000_000


class Stage(NamedTuple):
    """The N reachable beliefs after some steps.

    Attributes:
        rewards: N x A, expected.
        values: N x A, of the actions, from here to the end, discounted to this step.
        chances: N x A x O, P(o | belief, a); empty after the last step.
        following: N x A x O, the belief of the next stage; -1 where the observation is impossible.
    """

    rewards: Vector
    values: Vector
    chances: Vector
    following: Indices


def best_response(
    team: Team, plan: JointPlan, agent: int, goes_on: Callable[[], bool] = lambda: True
) -> tuple[float, Tree] | None:
    """Return the value of a plan with the best tree for an agent, and that tree.

    Unreachable parts of the tree stay as they were.

    Args:
        team: The team.
        plan: The others' trees, and the agent's present one.
        agent: The agent whose tree is replaced.
        goes_on: Asked now and then; False breaks off.

    Returns:
        None if it was broken off.

    Raises:
        ModelError: If it would take too much memory.
    """
    stages = _stages(team, plan, agent, len(plan[agent]), goes_on, MOST)
    if stages is None:
        return None
    tree: Tree = []
    nodes = np.zeros(1, dtype=np.intp)
    for stage, before in zip(stages, plan[agent], strict=True):
        reached = nodes >= 0
        actions = np.where(reached, stage.values.argmax(axis=1)[nodes], before)
        tree.append(actions)
        if stage.following.size:
            nodes = np.where(reached[:, None], stage.following[nodes, actions], -1).ravel()
    return float(stages[0].values[0].max()), tree


def solve_as_one(team: Team, horizon: int, goes_on: Callable[[], bool] = lambda: True) -> list[Stage] | None:
    """Return the exact solution of a team taken as one agent; None if it is too large or was broken off."""
    try:
        return _stages(team, [], 0, horizon, goes_on, _AS_ONE)
    except ModelError:
        return None


def _stages(
    team: Team, plan: JointPlan, agent: int, horizon: int, goes_on: Callable[[], bool], most: int
) -> list[Stage] | None:
    others = [other for other in range(team.num_agents) if other != agent]
    own, symbols = team.actions[agent], team.observations[agent]
    their_symbols = [team.observations[other] for other in others]
    seen = np.stack(np.unravel_index(np.arange(len(team.seen) // symbols), tuple(their_symbols)), 1) if others else None
    histories = np.zeros((1, len(others)), dtype=np.intp)
    beliefs = team.start[None, None, :]  # N x the others' joint histories x S
    steps: list[tuple[Vector, Vector, Indices]] = []
    for step in range(horizon):
        count, columns, size = beliefs.shape
        actions: list[Indices | int] = [0] * team.num_agents
        for place, other in enumerate(others):
            actions[other] = plan[other][step][histories[:, place]]
        last = step == horizon - 1
        if not last:
            check_size(beliefs.size * own * len(team.seen), horizon, most)
        rewards = np.empty((count, own))
        after = np.empty((count, own, symbols, 0 if last else columns * len(team.seen) // symbols, size))
        for action in range(own):
            if not goes_on():
                return None
            actions[agent] = action
            joint = np.broadcast_to(team.joint_actions(actions), (columns,))
            rewards[:, action] = beliefs.reshape(count, -1) @ team.rewards[joint].ravel()
            if not last:
                moved = team.advance(beliefs, joint).reshape(count, columns, *team.observations, size)
                after[:, action] = np.moveaxis(moved, 2 + agent, 1).reshape(count, symbols, -1, size)
        chances = after.sum(axis=(3, 4))
        following = np.full((count, own, symbols), -1, dtype=np.intp)
        if not last:
            possible = chances > 0
            reached = after[possible] / chances[possible][:, None, None]
            if seen is not None:
                histories = lengthened(histories, seen, their_symbols)
                occurring = np.flatnonzero(reached.any(axis=(0, 2)))
                reached, histories = reached[:, occurring], histories[occurring]
            first, following[possible] = merged(np.round(reached.reshape(len(reached), -1), _DIGITS))
            beliefs = reached[first]
        steps.append((rewards, chances, following))
    return _valued(steps, team.discount)


def _valued(steps: list[tuple[Vector, Vector, Indices]], discount: float) -> list[Stage]:
    stages: list[Stage] = []
    for rewards, chances, following in reversed(steps):
        values = rewards
        if stages:
            best = stages[-1].values.max(axis=1)
            values = rewards + discount * (chances * best[following]).sum(axis=2)
        else:
            chances, following = chances[:, :, :0], following[:, :, :0]  # noqa: PLW2901 - nothing follows the last
        stages.append(Stage(rewards, values, chances, following))
    return stages[::-1]


def merged(rows: Vector) -> tuple[Indices, Indices]:
    """Return the first places of the distinct rows of an array, and for each row its number among these."""
    rows = np.ascontiguousarray(rows + 0.0)  # -0.0 becomes 0.0: bytes are compared
    keys = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return first, which.ravel()
