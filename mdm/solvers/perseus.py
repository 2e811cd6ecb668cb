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

The value function of the next step is a matrix of vectors. A backup at b takes, for each action and observation, the
best vector at the belief that follows, and then the best action (ibid., equations 7 to 9). Cost: P(s', o | s, a) once,
and A O S N for N vectors, as products of matrices over blocks of beliefs.

In models with false negatives vectors are kept for each action. After a false negative the agent goes on with its
action, since it does not know of it. So in a backup for action a only vectors of action a may follow the false
negative. Vectors are therefore improved for each action by itself, Q(b, a) in place of V(b), so that each action has
one at every belief. This is how MADP plans for false negatives (J. V. Messias, M. T. J. Spaan and P. U. Lima,
*Asynchronous execution in multiagent POMDPs: reasoning over partially-observable events*, MSDM 2013). It costs A times
as many backups. Another vector of the same action may follow the false negative, with later choices that suit the
belief after one more missed event. This is the value of an agent that knows, at the next detection, how many events it
missed, as an agent with a clock may. The certificate is for an agent without that knowledge: there each vector is
followed by itself.

Rounds drop vectors that no point needs any more, though other vectors were made of them. The greatest vector at a
belief then promises more than the policy earns. For the certificate the vectors become the nodes of a controller over
the remaining vectors: each observation leads to the best vector at the belief that follows the node's own. The
controller's values solve linear equations (E. A. Hansen, *Solving POMDPs by searching in policy space*, UAI 1998,
section 3). They are approached by sweeps, and then lowered until no vector exceeds its backup. So a backup improves
them at every belief, and the policy that chooses by them earns no less. A sweep costs P(s', o | s, a) times the vectors
of each action. Where there are false negatives this holds for the controller, which goes along its edges. An agent that
chooses by the vectors at a tracker's belief may earn a little less: that belief does not discount long waits.

SARSOP keeps to the beliefs of good policies, and its bounds are closer. Choose Perseus for plans of a few decisions,
and where false negatives lead to too many states for SARSOP.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.errors import ConfigError, ModelError
from mdm.models.dynamics import Dynamics, Indices
from mdm.models.matrices import Vector, distribution
from mdm.policies import AlphaVectors, FiniteStateController
from mdm.solvers.bounds import blind_values, informed_values
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import numpy.typing as npt

    from mdm.models import POMDP
    from mdm.models.matrices import Matrix
    from mdm.solvers.joint_dynamics import Only
    from mdm.solvers.solution import Solution

_NAME = "perseus"
_EVERY = 4
"""Vectors are certified once in so many rounds; it costs about half as much as a round."""
_BLOCK = 64
"""The most points that are backed up together."""
_MOST = 1_000_000_000


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
        model: The model; its observations depend on states or are events. Factored ones are flattened.
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
        self._function = Improved(dynamics, points, self.sure, false_negative)
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


# -- Backups -----------------------------------------------------------------------------------------------------------

_ROUNDING = 1e-12


class Vectors(NamedTuple):
    """Alpha vectors (N x S), their actions, and the points at which they were made."""

    values: Vector
    actions: Indices
    points: Indices

    def taken(self, which: Any) -> Vectors:
        """Return some of them."""
        return Vectors(self.values[which], self.actions[which], self.points[which])

    @staticmethod
    def joined(parts: Sequence[Vectors]) -> Vectors:
        """Return several as one."""
        return Vectors(
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.actions for part in parts]),
            np.concatenate([part.points for part in parts]),
        )


class Choice(NamedTuple):
    """The values of an action at some points, and the vector that follows each observation: n, and n x O."""

    values: Vector
    following: Indices


def choose(dynamics: JointDynamics, action: int, points: Matrix, vectors: Vector, only: Only | None = None) -> Choice:
    """Return the values of an action at some points, and the vectors that follow. See `JointDynamics.follow`."""
    during = dynamics.during(action, points)
    ahead, following = dynamics.follow(action, during, vectors, only)
    return Choice(during @ dynamics.rewards[action] + dynamics.discount * ahead, following)


def best(dynamics: JointDynamics, points: Matrix, vectors: Vector) -> tuple[Vector, Indices]:
    """Return the vector and action that a backup makes at each point; of equal actions the lowest."""
    each = [choose(dynamics, action, points, vectors) for action in range(dynamics.num_actions)]
    actions = np.argmax([choice.values for choice in each], axis=0)
    result = np.empty((len(actions), dynamics.size))
    for action in np.unique(actions).tolist():
        at = actions == action
        result[at] = dynamics.vectors(action, vectors, each[action].following[at])
    return result, actions


def improve(
    old: Vectors,
    points: Matrix,
    backup: Callable[[Matrix], tuple[Vector, Indices]],
    random: np.random.Generator,
    limits: Limits,
    *,
    every: bool = False,
) -> tuple[Vectors, float]:
    """Return vectors that are as good at all points and better at some, and the greatest improvement.

    Points that the new vectors have not improved yet are backed up in random order (M. T. J.
    Spaan and N. Vlassis, *Perseus: randomized point-based value iteration for POMDPs*, JAIR 24, 2005, table 1): one
    point, then two, then four, up to a block of them at once.

    Args:
        old: The vectors before.
        points: n x S.
        backup: Makes a vector, and its action, for each of some points.
        random: Orders the points.
        limits: Ends it early; the old vectors are kept then beside the new ones.
        every: Back up all points, also those that other backups improved.
    """
    old_scores = points @ np.ascontiguousarray(old.values.T)
    owners = old_scores.argmax(axis=1)
    before = old_scores[np.arange(len(owners)), owners]
    slack = _ROUNDING * np.abs(before).max()
    enough = before - slack
    after = np.full(len(before), -np.inf)
    made: list[Vectors] = []
    kept: set[int] = set()
    waiting = random.permutation(len(before))
    count = _BLOCK if every else 1
    while len(waiting) and limits.remaining >= 0:
        block, waiting = waiting[:count], waiting[count:]
        count = min(2 * count, _BLOCK)
        values, actions = backup(points[block])
        scores = points @ np.ascontiguousarray(values.T)
        new = []
        for place, point in enumerate(block.tolist()):
            if after[point] >= (max(enough[point], scores[point, place]) if every else enough[point]):
                continue
            if scores[point, place] > before[point] + slack:
                new.append(place)
                after = np.maximum(after, scores[:, place])
            elif owners[point] not in kept:
                kept.add(int(owners[point]))
                after = np.maximum(after, old_scores[:, owners[point]])
        made.append(Vectors(values[new], actions[new], block[new]))
        if not every:
            waiting = waiting[after[waiting] < enough[waiting]]
    stay = sorted(kept) if not len(waiting) else np.arange(len(old.actions))
    result = Vectors.joined([*made, old.taken(stay)])
    return result, float(np.maximum(after - before, 0.0).max(initial=0.0))


def needed(vectors: Vectors, points: Matrix) -> Vectors:
    """Return the vectors that are the best of their action at some point."""
    scores = points @ np.ascontiguousarray(vectors.values.T)
    found: set[int] = set()
    for action in np.unique(vectors.actions):
        own = np.flatnonzero(vectors.actions == action)
        found.update(own[scores[:, own].argmax(axis=1)].tolist())
    return vectors.taken(sorted(found))


class Improved:
    """Vectors that rounds improve; where there are false negatives, those of each action by themselves.

    Args:
        dynamics: The model.
        points: The beliefs, n x S.
        start: A vector for each action, at least.
        false_negative: Its place among the observations of the dynamics, if there is one.
    """

    def __init__(self, dynamics: JointDynamics, points: Matrix, start: Vectors, false_negative: int | None) -> None:
        self._dynamics = dynamics
        self._points = points
        self._false_negative = false_negative
        self.vectors = start

    def round(self, random: np.random.Generator, limits: Limits, *, every: bool) -> float:
        """Improve the vectors at all points; return by how much at most."""
        old, parts, changes = self.vectors, [], []
        if self._false_negative is None:
            every_action = partial(best, self._dynamics, vectors=old.values)
            self.vectors, change = improve(old, self._points, every_action, random, limits, every=every)
            return change
        for action in range(self._dynamics.num_actions):
            own = np.flatnonzero(old.actions == action)
            only: Only = self._false_negative, own

            def backup(points: Matrix, action: int = action, only: Only = only) -> tuple[Vector, Indices]:
                chosen = choose(self._dynamics, action, points, old.values, only)
                values = self._dynamics.vectors(action, old.values, chosen.following)
                return values, np.full(len(values), action)

            part, change = improve(old.taken(own), self._points, backup, random, limits, every=every)
            parts.append(part)
            changes.append(change)
        self.vectors = Vectors.joined(parts)
        return max(changes)


# -- Beliefs -----------------------------------------------------------------------------------------------------------

_DIGITS = 7
"""Beliefs that agree to so many digits are one."""
_TRIES = 20
"""The most steps for each belief asked for."""
_COPIES = 8 * 8
"""Bytes that are reserved for each number of a belief: the numbers of a round are as many."""
_ENDS = 0.01, 0.1
"""The least and the greatest chance that a walk ends after a step."""


def starts(model: POMDP) -> Vector:
    """Return the beliefs before the first action, each times its probability: k x S.

    It is one, but where factors of the state are observed from the start.
    """
    belief = model.initial_belief
    groups = model.seen_in
    return np.stack([np.where(groups == seen, belief, 0.0) for seen in np.unique(groups[belief > 0])])


def sampled(
    model: POMDP,
    dynamics: JointDynamics,
    first: Vector,
    beliefs: int | npt.ArrayLike,
    random: np.random.Generator,
    limits: Limits,
) -> Vector:
    """Return different beliefs as an n x S array, those at the start first.

    Args:
        model: The model; its steps without a detection are taken into account as a tracker does.
        dynamics: The effects of its actions.
        first: Its `starts`.
        beliefs: How many to find, or an n x S array of them. Fewer are found where there are no more, or no room.
        random: Draws actions and observations.
        limits: Ends the search.

    Raises:
        ConfigError: If the number is not positive.
        ModelError: If a given belief is no distribution.
    """
    if not isinstance(beliefs, int | np.integer):
        size = len(model.state_space)
        rows = [distribution(row, what=f"belief {at}", size=size) for at, row in enumerate(np.atleast_2d(beliefs))]
        return np.stack(list(_each_once([*_normalised(first), *rows])))
    if beliefs < 1:
        raise ConfigError(f"Perseus needs at least 1 belief, not {beliefs}", key="beliefs")
    found: list[Vector] = []
    beliefs = max(1, min(int(beliefs), limits.room // (_COPIES * dynamics.size)))
    walks = _walks(_Step(model, dynamics), first, model.discount, _TRIES * beliefs, random)
    for belief in _each_once(walks):
        found.append(belief)
        if len(found) == beliefs or limits.remaining < 0:
            break
    return np.stack(found)


def _walks(step: _Step, first: Vector, discount: float, steps: int, random: np.random.Generator) -> Iterator[Vector]:
    """Yield the beliefs at the start, and those of random walks from there."""
    chance = min(max(1 - discount, _ENDS[0]), _ENDS[1])
    shares = first.sum(axis=1)
    first = _normalised(first)
    yield from first
    after: Vector | None = None
    for _ in range(steps):
        belief = first[random.choice(len(first), p=shares / shares.sum())] if after is None else after
        yield belief
        after = None if random.random() < chance else step(belief, random)


class _Step:
    """Moves a belief along a random action and a random observation."""

    def __init__(self, model: POMDP, dynamics: JointDynamics) -> None:
        self._model = model
        self._dynamics = dynamics
        self._detected = np.array([o != model.false_negative for o in dynamics.observations])

    def __call__(self, belief: Vector, random: np.random.Generator) -> Vector | None:
        """Return the next belief; None where nothing is ever detected."""
        action = int(random.integers(self._dynamics.num_actions))
        before = self._model.resolvent(action).weights(belief) if self._model.waits_in(action) else belief
        symbols, states, weights = self._dynamics.after(action, np.maximum(before, 0.0))
        chances = np.bincount(symbols, weights, minlength=len(self._detected)) * self._detected
        total = chances.sum()
        if not total > 0:
            return None
        chosen = random.choice(len(chances), p=chances / total)
        belief = np.zeros(self._dynamics.size)
        belief[states[symbols == chosen]] = weights[symbols == chosen]
        return np.asarray(belief / belief.sum())


def _normalised(rows: Vector) -> Vector:
    return np.asarray(rows / rows.sum(axis=1, keepdims=True))


def _each_once(beliefs: Iterable[Vector]) -> Iterator[Vector]:
    known = set()
    for belief in beliefs:
        rounded = np.round(belief, _DIGITS)
        (states,) = rounded.nonzero()
        key = states.tobytes(), rounded[states].tobytes()
        if key not in known:
            known.add(key)
            yield belief


# -- Certificates ------------------------------------------------------------------------------------------------------

_SWEEPS = 1000
_LATE = 0.5, 0.05
"""The last sweeps may take so many seconds, and such a share of the time before, when the time is up."""


def certified(dynamics: JointDynamics, points: Matrix, vectors: Vectors, precision: float, limits: Limits) -> Vectors:
    """Return the vectors, lowered to the least value of a policy that chooses by them.

    Args:
        dynamics: The model.
        points: n x S.
        vectors: The vectors.
        precision: By how much they may be too low.
        limits: Ends the sweeps, a little after the time is up; the vectors are then lower.
    """
    groups = []
    for action in np.unique(vectors.actions).tolist():
        at = np.flatnonzero(vectors.actions == action)
        blocks = np.array_split(vectors.points[at], len(at) // _BLOCK + 1)
        chosen = [choose(dynamics, action, points[block], vectors.values).following for block in blocks]
        groups.append((action, at, np.concatenate(chosen)))

    def backed(values: Vector) -> Vector:
        result = np.empty_like(values)
        for action, at, following in groups:
            result[at] = dynamics.vectors(action, values, following)
        return result

    values = vectors.values
    began = limits.seconds
    for _ in range(_SWEEPS):
        better = backed(values)
        change = float(np.abs(better - values).max())
        values = better
        if change * dynamics.discount <= precision * (1 - dynamics.discount):
            break
        if limits.remaining < 0 and limits.seconds - began > _LATE[0] + _LATE[1] * began:
            break
    excess = max(float((values - backed(values)).max()), 0.0)
    return vectors._replace(values=values - excess / (1 - dynamics.discount))


def upper_bound(dynamics: JointDynamics, starts: Vector, limits: Limits, horizon: int | None = None) -> float:
    """Return an upper bound of the value at the start.

    Args:
        dynamics: The model.
        starts: The beliefs at the start, each times its probability: k x S.
        limits: Ends the sweeps. With a horizon there is then no bound but inf.
        horizon: How many decisions there are.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    informed = dynamics.informed
    if horizon is None:
        table = informed_values(dynamics.dynamics, limits, informed)
    else:
        table = np.zeros((dynamics.size, dynamics.num_actions))
        for _ in range(horizon):
            if limits.remaining < 0:
                return np.inf
            table = informed.backup(table)
    return float((starts @ table).max(axis=1).sum())
