"""Backups of blocks of beliefs, and the randomised choice of beliefs to back up.

The value function of the next step is a matrix of vectors. A backup at b takes, for each action and observation, the
best vector at the belief that follows, and then the best action (J. Pineau, G. Gordon and S. Thrun, *Point-based
value iteration: an anytime algorithm for POMDPs*, IJCAI 2003, equations 7 to 9).

In models with false negatives vectors are kept for each action. After a false negative the agent goes on with its
action, since it does not know of it. So in a backup for action a only vectors of action a may follow the false
negative. Vectors are therefore improved for each action by itself, Q(b, a) in place of V(b), so that each action has
one at every belief. This is how MADP plans for false negatives (J. V. Messias, M. T. J. Spaan and P. U. Lima,
*Asynchronous execution in multiagent POMDPs: reasoning over partially-observable events*, MSDM 2013). It costs A times
as many backups.

Another vector of the same action may follow the false negative, with later choices that suit the belief after one more
missed event. This is the value of an agent that knows, at the next detection, how many events it missed, as an agent
with a clock may. The certificate is for an agent without that knowledge: there each vector is followed by itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.models.dynamics import Indices  # noqa: TC001 - the same
from mdm.models.matrices import Vector  # noqa: TC001 - the fields' types are looked at

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models.matrices import Matrix
    from mdm.solvers.joint_dynamics import JointDynamics, Only
    from mdm.solvers.solution import Limits

__all__ = ["Choice", "Constrained", "Vectors", "best", "choose", "improve", "needed"]

_ROUNDING = 1e-12
_BLOCK = 64
"""The most points that are backed up together."""


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


class Constrained:
    """Vectors of each action, improved together.

    Args:
        dynamics: The model.
        points: The beliefs, n x S.
        start: A vector for each action, at least.
        false_negative: Its place among the observations of the dynamics.
    """

    def __init__(self, dynamics: JointDynamics, points: Matrix, start: Vectors, false_negative: int) -> None:
        self._dynamics = dynamics
        self._points = points
        self._false_negative = false_negative
        self.vectors = start

    def round(self, random: np.random.Generator, limits: Limits, *, every: bool) -> float:
        """Improve each action's vectors at all points; return by how much at most."""
        old, parts, changes = self.vectors, [], []
        for action in range(self._dynamics.num_actions):
            own = np.flatnonzero(old.actions == action)
            before = old.taken(own)

            def backup(points: Matrix, action: int = action, own: Indices = own) -> tuple[Vector, Indices]:
                chosen = choose(self._dynamics, action, points, old.values, only=(self._false_negative, own))
                values = self._dynamics.vectors(action, old.values, chosen.following)
                return values, np.full(len(values), action)

            part, change = improve(before, self._points, backup, random, limits, every=every)
            parts.append(part)
            changes.append(change)
        self.vectors = Vectors.joined(parts)
        return max(changes)
