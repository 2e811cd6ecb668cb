"""The fast informed bound: QMDP that knows what is observed.

    alpha_a(s) = R(s, a) + discount * sum over o of max over a' of sum over s' of P(s', o | s, a) alpha_a'(s')

(M. Hauskrecht, *Value-function approximations for partially observable Markov decision processes*, Journal of
Artificial Intelligence Research 13, 2000, section 3.5.) One vector per action, an upper bound of the optimal value
function at least as tight as QMDP's, for the next action is chosen by the observation, not by the state. Backups begin
at QMDP's vectors and lower them, so that they are bounds at every step; each costs A times the entries of all
P(s', o | s, a), of which there are up to O times as many as transitions. Choose QMDP where that is too much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.models.compressed import csr, is_compressed
from mdm.models.detection import check_no_false_negatives
from mdm.models.dynamics import Dynamics
from mdm.policies import AlphaVectors
from mdm.solvers.limits import Limits
from mdm.solvers.qmdp import known_state

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.models import POMDP
    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.solution import Solution

__all__ = ["fast_informed_bound"]

_ROUNDING = 1e-14
"""By what share of the vectors backups must still change them."""
_NOTHING = 1e-9
"""Probabilities below are rounding."""
_SETTLED = 1e-3
"""With a discount of 1, backups end when they change vectors by less than this share of the gap."""


def fast_informed_bound(model: POMDP, *, limits: Limits | None = None) -> Solution:
    """Return an upper bound of a POMDP's value function as `AlphaVectors`, one per action.

    Args:
        model: The model, with observations of either kind; factored ones are flattened. Where observations of events do
            not sum to 1, the rest is taken for one more of them.
        limits: When to stop; the gap is how far the vectors may be from their limit, and the iterations are backups,
            those for QMDP's vectors included.

    Returns:
        The vectors, and the upper bound that they are; nothing is proven of what their policy is worth: ``lower`` is
        -inf. With a discount of 1 they are a bound only once QMDP's are exact; before, ``upper`` is inf.

    Raises:
        ModelError: If the discount is 1, and values grow or fall without end; or the model has false negatives.
    """
    check_no_false_negatives(model, "the fast informed bound")
    with Limits() if limits is None else limits as run:
        flat = model.flatten()
        count = len(flat.action_space)
        belief = flat.initial_belief
        iterations = 0
        for table, bounds in _bounds(flat, run.gap):
            iterations += 1
            upper = float((belief @ table).max()) if bounds else np.inf
            if run.ends(-np.inf, upper, iterations=iterations, size=count):
                break
        else:
            run.reason = "converged"
        return run.solution(
            AlphaVectors(table.T, range(count), count), "fib", -np.inf, upper, iterations=iterations, size=count
        )


def _bounds(model: POMDP, gap: float) -> Iterator[tuple[Vector, bool]]:
    """Yield vectors, S x A, ever lower, and whether they are bounds."""
    dynamics = Dynamics(model)
    for table, bounds in known_state(dynamics, gap):
        yield table, bounds
    joints = [_joint(model, action) for action in range(dynamics.num_actions)]
    slowness = dynamics.discount / (1 - dynamics.discount) if dynamics.discount < 1 else 1 / _SETTLED
    change = np.inf
    while slowness * change > gap and change > _ROUNDING * np.abs(table).max():
        backed = [joint.backup(table, dynamics.num_states) for joint in joints]
        lowered = np.minimum(dynamics.rewards + dynamics.discount * np.stack(backed, axis=1), table)
        change = float((table - lowered).max())
        table = lowered
        yield table, True


class _Joint(NamedTuple):
    """P(s', o | s, a) of one action: those rows, over s', of pairs (s, o) that are possible.

    Attributes:
        matrix: The rows.
        states: The s of each.
    """

    matrix: Matrix
    states: Any

    def backup(self, table: Vector, size: int) -> Vector:
        """Return for each state the expected value after the action, the next one chosen by what is observed."""
        after = (self.matrix @ table).max(axis=1)
        return np.bincount(self.states, weights=after, minlength=size).astype(np.float64)


def _joint(model: POMDP, action: int) -> _Joint:
    transition = model.transition_matrix(action)
    rest = transition if is_compressed(transition) else csr(transition)
    parts = []
    for observation in range(len(model.observation_space)):
        matrix = model.joint_matrix(action, observation)
        parts.append(matrix if is_compressed(matrix) else csr(matrix))
        if model.event_observations:
            rest = rest - parts[-1]
    if model.event_observations:
        rest.data[rest.data < _NOTHING] = 0
        parts.append(rest)
    data, indices, lengths, states = [], [], [], []
    for part in parts:
        part.eliminate_zeros()
        found = np.diff(part.indptr)
        data.append(part.data)
        indices.append(part.indices)
        lengths.append(found[found > 0])
        states.append(np.flatnonzero(found))
    starts = np.concatenate(([0], np.cumsum(np.concatenate(lengths))))
    matrix = csr((np.concatenate(data), np.concatenate(indices), starts), (len(starts) - 1, transition.shape[1]))
    return _Joint(matrix, np.concatenate(states))
