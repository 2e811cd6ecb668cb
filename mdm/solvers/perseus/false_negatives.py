"""Value functions for models with false negatives: vectors are kept for each action.

After a false negative the agent goes on with its action, since it does not know of it. So in a backup for action a only
vectors of action a may follow the false negative. Vectors are therefore improved for each action by itself, Q(b, a) in
place of V(b), so that each action has one at every belief. This is how MADP plans for false negatives
(J. V. Messias, M. T. J. Spaan and P. U. Lima, *Asynchronous execution in multiagent POMDPs: reasoning over
partially-observable events*, MSDM 2013). It costs A times as many backups.

Another vector of the same action may follow the false negative, with later choices that suit the belief after one more
missed event. This is the value of an agent that knows, at the next detection, how many events it missed, as an agent
with a clock may. The certificate is for an agent without that knowledge: there each vector is followed by itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.solvers.perseus.backup import Vectors, choose, improve

if TYPE_CHECKING:
    from mdm.models.dynamics import Indices
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.joint_dynamics import JointDynamics
    from mdm.solvers.limits import Limits

__all__ = ["Constrained"]


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
