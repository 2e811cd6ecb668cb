"""Perseus: randomised point-based value iteration.

Alpha vectors are improved at a fixed set of beliefs, those that random exploration meets: in each round beliefs are
backed up in random order until the value of none is less than before; most need no vector of their own
(M. T. J. Spaan and N. Vlassis, *Perseus: randomized point-based value iteration for POMDPs*, JAIR 24, 2005). It begins
with the value of each action, done for ever, so that every vector is a plan's value, and a lower bound of the
optimal one. Every few rounds, and at the end, the vectors are evaluated as a plan: this certifies the policy, and the
next rounds begin from these values, so that far fewer are needed (point-based policy iteration: S. Ji,
R. Parr, H. Li, X. Liao and L. Carin, AAAI 2007). The upper bound is the fast informed bound, which no round improves.

With a ``horizon`` there are plans of a few decisions, as graphs: point-based backups from the last decision to the
first. A vector of a stage is a node: an action, and for each observation a vector of the next stage. The graph's values
are exact; a false negative stays at its node. Each stage backs up all points and keeps the different results
(J. Pineau, G. Gordon and S. Thrun, *Point-based value iteration: an anytime algorithm for POMDPs*, IJCAI 2003), at most
one node for each.

Cost of a backup: P(s', o | s, a) once, and A O S N for N vectors, as products of matrices over blocks of beliefs.
SARSOP keeps to the beliefs of good policies, and its bounds are closer. Choose Perseus for plans of a few decisions,
and where false negatives lead to too many states for SARSOP (see `mdm.solvers.perseus.backup`).
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from mdm.errors import ConfigError, ModelError
from mdm.models.dynamics import Dynamics, Indices
from mdm.models.matrices import Vector  # noqa: TC001 - the fields' types are looked at
from mdm.policies import AlphaVectors, FiniteStateController
from mdm.solvers.bounds import blind_values
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.perseus.backup import Constrained, Vectors, best, choose, improve, needed
from mdm.solvers.perseus.certificate import certified, upper_bound
from mdm.solvers.perseus.points import sampled, starts
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import POMDP
    from mdm.models.matrices import Matrix
    from mdm.solvers.solution import Solution

__all__ = ["perseus", "plan"]

_NAME = "perseus"
_EVERY = 4
"""Vectors are certified once in so many rounds; it costs about half as much as a round."""
_BLOCK = 64
_MOST = 1_000_000_000


class _ValueFunction(Protocol):
    """Alpha vectors that rounds improve."""

    vectors: Vectors

    def round(self, random: np.random.Generator, limits: Limits, *, every: bool) -> float:
        """Improve the vectors; return by how much at most."""
        ...


@makes(AlphaVectors, to_horizon=FiniteStateController)
def perseus(
    model: POMDP,
    *,
    limits: Limits | None = None,
    beliefs: int | npt.ArrayLike = 1000,
    seed: int | None = 0,
    horizon: int | None = None,
) -> Solution:
    """Solve a POMDP at the beliefs that random exploration meets.

    Where factors of the state are observed from the start (`POMDP.revealed`), the bounds are for an agent that sees
    them. After a false negative of the model the action goes on. The lower bound is then that of the vectors as a plan:
    the next detection chooses the vector that follows, however many false negatives came before.

    It has ``converged`` when the improvement of a round shows that more rounds cannot add more than the gap.

    Args:
        model: The model; its observations tell of states or are events. Factored ones are flattened.
        limits: When to stop, and where to report; its iterations are rounds.
        beliefs: How many beliefs to find, or an array of them, n x S. The initial one is always among them.
        seed: Of the exploration and the order of backups; the same seed gives the same policy.
        horizon: How many decisions there are. The policy is then a `FiniteStateController`, a plan from the initial
            belief.

    Raises:
        ModelError: If the discount is 1 and there is no horizon, or the horizon is far too long.
        ConfigError: If the number of beliefs or the horizon is not positive.
    """
    if horizon is not None and horizon < 1:
        raise ConfigError(f"a horizon is a number of decisions from 1 on, not {horizon}", key="horizon")
    if model.discount >= 1 and horizon is None:
        raise ModelError("Perseus needs a discount below 1, or a horizon: give one (--discount, --horizon)")
    random = np.random.default_rng(seed)
    with Limits() if limits is None else limits as run:
        flat, first = model.flatten(), starts(model)
        if horizon is not None:
            return plan(flat, first, run, beliefs, random, horizon)
        plain = Dynamics(flat)
        dynamics = JointDynamics(plain)
        # Bounds are for an agent that does not know how many false negatives there were.
        actual = dynamics if flat.false_negative is None else JointDynamics(plain, flat.false_negative)
        upper = upper_bound(actual, first, run)
        points = dynamics.points(sampled(flat, dynamics, first, beliefs, random, run))
        search = _Search(first, dynamics, actual, points, flat.false_negative, run)
        search.run(upper, random)
        policy = AlphaVectors(search.sure.values, search.sure.actions.tolist(), dynamics.num_actions)
        size = len(search.sure.actions)
        return run.solution(policy, _NAME, search.lower, upper, iterations=search.rounds, size=size)


class _Search:
    """The state of a run: the vectors that rounds improve, and the best ones that are certified."""

    def __init__(
        self,
        first: Vector,
        dynamics: JointDynamics,
        actual: JointDynamics,
        points: Matrix,
        false_negative: int | None,
        limits: Limits,
    ) -> None:
        self._starts = first
        self._points = points
        self._limits = limits
        self._discount = dynamics.discount
        self._actual = actual
        count = dynamics.num_actions
        blind = blind_values(dynamics.dynamics)
        self.sure = Vectors(blind, np.arange(count), np.zeros(count, dtype=np.intp))
        self._function: _ValueFunction = (
            _Plain(dynamics, points, self.sure)
            if false_negative is None
            else Constrained(dynamics, points, self.sure, false_negative)
        )
        self.lower = self._value(self.sure)
        self.rounds = 0

    def _value(self, vectors: Vectors) -> float:
        return float((self._starts @ vectors.values.T).max(axis=1).sum())

    def run(self, upper: float, random: np.random.Generator) -> None:
        """Improve the vectors until the limits end it or they have converged.

        Rounds that improve less than the tolerance are followed by one that backs up every point.
        """
        limits, function, every = self._limits, self._function, False
        while not limits.ends(self.lower, upper, iterations=self.rounds, size=len(function.vectors.actions)):
            scale = float(np.abs(function.vectors.values).max())
            tolerance = max(limits.gap * (1 - self._discount) / self._discount, 1e-12 * scale)
            change = function.round(random, limits, every=every)
            self.rounds += 1
            if limits.remaining < 0:
                continue
            if every and change <= tolerance:
                limits.reason = "converged"
                break
            every = change <= tolerance
            due = not self.rounds % _EVERY
            if due or upper - self._value(function.vectors) <= limits.gap:
                function.vectors = needed(Vectors.joined([function.vectors, self._certify()]), self._points)
        self._certify()

    def _certify(self) -> Vectors:
        """Return the vectors with certified values, and keep them if they are the best so far."""
        precision = 0.1 * max(self._limits.gap, 1e-9)
        vectors = certified(self._actual, self._points, self._function.vectors, precision, self._limits)
        if (value := self._value(vectors)) > self.lower:
            self.sure, self.lower = vectors, value
        return vectors


class _Plain:
    """One set of vectors for all actions."""

    def __init__(self, dynamics: JointDynamics, points: Matrix, start: Vectors) -> None:
        self._dynamics = dynamics
        self._points = points
        self.vectors = start

    def round(self, random: np.random.Generator, limits: Limits, *, every: bool) -> float:
        """Improve the vectors at all points; return by how much at most."""
        backup = partial(best, self._dynamics, vectors=self.vectors.values)
        self.vectors, change = improve(self.vectors, self._points, backup, random, limits, every=every)
        return change


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
