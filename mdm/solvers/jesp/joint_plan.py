"""Joint plans, for each agent a tree of actions by its own observations; and best responses to the others' plans.

The exact value follows all joint histories that can occur, with the distribution over states that comes with each:
O(A^0 S^2 O^t) at step t at most, O being the joint observations. A `Team` is a Dec-POMDP for its agents.

With the others' plans fixed, an agent faces a POMDP whose states are the world's together with the others' histories.
Its reachable beliefs are followed forward, equal ones once, and their values computed backward (R. Nair, M. Tambe,
M. Yokoo, D. Pynadath and S. Marsella, *Taming decentralized POMDPs: towards efficient policy computation for multiagent
settings*, IJCAI 2003, DP-JESP). At step t there are at most (A_i O_i)^t beliefs, each of S numbers for each of the
others' joint histories. For a team taken as one agent this is the exact solution of the MPOMDP.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics, Indices
from mdm.policies import FiniteStateController, JointController

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models import POMDP
    from mdm.models.matrices import Vector

__all__ = [
    "MOST",
    "JointPlan",
    "Stage",
    "Team",
    "Tree",
    "as_controller",
    "best_response",
    "merged",
    "plan_size",
    "plan_value",
    "random_plan",
    "solve_as_one",
]

MOST = 50_000_000
"""Numbers that one step of a computation may take: 400 MB."""
_DIGITS = 12
"""Beliefs that agree to so many digits are one."""
_AS_ONE = 4_000_000


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
