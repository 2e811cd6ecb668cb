"""Plans of a few decisions, as graphs: point-based backups from the last decision to the first.

A vector of a stage is a node: an action, and for each observation a vector of the next stage. The graph's values are
exact; a false negative stays at its node. Each stage backs up all points and keeps the different results (J. Pineau, G.
Gordon and S. Thrun, *Point-based value iteration: an anytime algorithm for POMDPs*, IJCAI 2003), at most one node for
each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics, Indices
from mdm.models.matrices import Vector  # noqa: TC001 - the fields' types are looked at
from mdm.policies import FiniteStateController
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.perseus.backup import choose
from mdm.solvers.perseus.certificate import upper_bound
from mdm.solvers.perseus.points import sampled

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import POMDP
    from mdm.models.matrices import Matrix
    from mdm.solvers.limits import Limits
    from mdm.solvers.solution import Solution

__all__ = ["plan"]

_NAME = "perseus"
_BLOCK = 64
_MOST = 1_000_000_000


class _Stage(NamedTuple):
    """Vectors of a stage (N x S), their actions (N), and the vectors of the next stage that follow them (N x O)."""

    values: Vector
    actions: Indices
    following: Indices


def plan(
    model: POMDP,
    first: Vector,
    limits: Limits,
    beliefs: int | npt.ArrayLike,
    random: np.random.Generator,
    horizon: int,
) -> Solution:
    """Return a plan of so many decisions, as a controller. See `mdm.solvers.perseus.perseus`.

    Where it has to stop early, the missing stages are planned for the initial belief alone.

    Raises:
        ModelError: If there are too many decisions.
    """
    dynamics = JointDynamics(Dynamics(model), model.false_negative)
    numbers = horizon * (dynamics.size + len(model.observation_space))  # of a node for each decision, at least
    if numbers > _MOST:
        raise ModelError(f"a plan of {horizon:,} decisions needs {numbers:,} numbers; take a shorter horizon")
    upper = upper_bound(dynamics, first, limits, horizon)
    points = dynamics.points(sampled(model, dynamics, model.initial_belief[None], beliefs, random, limits))
    stages: list[_Stage] = []
    values = np.zeros((1, dynamics.size))
    stopped = False
    for stage in range(1, horizon + 1):
        stopped = stopped or limits.ends(-np.inf, upper, iterations=stage - 1, size=sum(len(s.actions) for s in stages))
        stages.append(_stage(dynamics, points[:1] if stopped or stage == horizon else points, values))
        values = stages[-1].values
    controller = _controller(stages, dynamics, len(model.observation_space))
    lower = float(values[0] @ model.initial_belief)
    size = controller.num_nodes
    if not limits.ends(lower, upper, iterations=horizon, size=size):
        limits.reason = "converged"
    return limits.solution(controller, _NAME, lower, upper, iterations=horizon, size=size)


def _stage(dynamics: JointDynamics, points: Matrix, values: Vector) -> _Stage:
    """Back up points; return the different results."""
    found: dict[tuple[int, bytes], Indices] = {}
    for first in range(0, points.shape[0], _BLOCK):
        block = points[first : first + _BLOCK]
        each = [choose(dynamics, action, block, values) for action in range(dynamics.num_actions)]
        for point, action in enumerate(np.argmax([choice.values for choice in each], axis=0).tolist()):
            following = each[action].following[point]
            found.setdefault((action, following.tobytes()), following)
    actions, following = np.array([action for action, _ in found]), np.stack(list(found.values()))
    result = np.empty((len(found), dynamics.size))
    for action in np.unique(actions).tolist():
        result[actions == action] = dynamics.vectors(action, values, following[actions == action])
    return _Stage(result, actions, following)


def _controller(stages: list[_Stage], dynamics: JointDynamics, num_observations: int) -> FiniteStateController:
    """Return the graph of all nodes that follow the one node of the first decision."""
    nodes = [(len(stages) - 1, 0)]
    number = {nodes[0]: 0}
    successors = []
    for stage, place in nodes:  # which grows meanwhile
        row: list[int | None] = [None] * num_observations
        if stage:
            for observation, after in zip(dynamics.observations, stages[stage].following[place].tolist(), strict=True):
                if (stage - 1, after) not in number:
                    number[stage - 1, after] = len(nodes)
                    nodes.append((stage - 1, after))
                row[observation] = number[stage - 1, after]
        successors.append(row)
    actions = [int(stages[stage].actions[place]) for stage, place in nodes]
    return FiniteStateController(actions, successors, dynamics.num_actions)
