"""Bounds of a POMDP's value function, as vectors over the states.

Lower bounds are blind policies, one action for ever, whatever is observed (M. Hauskrecht, *Incremental methods for
computing bounds in partially observable Markov decision processes*, AAAI 1997). Upper bounds are the values of known
states, those of the underlying MDP, and the fast informed bound, which lets the next action depend on the observation
alone,

    alpha_a(s) = R(s, a) + discount * sum over o of max over a' of sum over s' of P(s', o | s, a) alpha_a'(s')

(M. Hauskrecht, *Value-function approximations for partially observable Markov decision processes*, Journal of
Artificial Intelligence Research 13, 2000, sections 3.4 and 3.5).

All of them are bounds wherever the sweeps end: sweeps of blind policies and of known states bound their own limits (see
`mdm.solvers.mdp.value_iteration`), those of the fast informed bound begin above and only lower the vectors. A sweep
costs the entries of all T; one of the fast informed bound A times those of all P(s', o | s, a).

Their vectors make policies, one alpha vector per action each. QMDP acts as if the state were known after the next step:
its vectors are the values Q(s, a) of the underlying MDP (M. L. Littman, A. R. Cassandra and L. P. Kaelbling, *Learning
policies for partially observable environments: scaling up*, ICML 1995, section 3). They are upper bounds of the optimal
value function, and never choose an action for its information. The cost is that of the MDP, whatever the observations.
The fast informed bound is at least as tight: the next action is chosen by the observation, not by the state. Backups
begin at QMDP's vectors and lower them, so that they are bounds at every step. Choose it where observations tell little
of the state, and SARSOP or Perseus where a policy must gather information before it acts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.compilation import can_compile
from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics
from mdm.models.events import check_no_false_negatives
from mdm.policies import AlphaVectors
from mdm.solvers.mdp.policy_iteration import steps
from mdm.solvers.mdp.value_iteration import rounding, rounds, sweeping
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mdm.models import MDP, POMDP
    from mdm.models.dynamics import Joint
    from mdm.models.matrices import Vector
    from mdm.solvers.solution import Solution

_BLIND_SWEEPS = 100_000
_CLOSE = 1e-9
"""How near blind policies and known states come to their limits, as a share of the greatest sum of rewards."""
_INFORMED_CLOSE = 2e-6
"""How near the fast informed bound comes to its limit, as a share of the range of its values."""
_EACH = 15
"""One of so many sweeps over known states finds the best actions."""
_KNOWN_TIME, _INFORMED_TIME = 0.2, 0.1
"""The parts of the time that is left for sweeps over known states, and for those of the fast informed bound."""
_ROUNDING = 1e-12
_LARGE = 10_000
"""From so many numbers in a sweep on its compilation pays."""


def for_ever(reward: float, discount: float) -> float:
    """Return the value of a reward in every step.

    Raises:
        ModelError: If it is too much for numbers.
    """
    with np.errstate(over="ignore"):
        value = float(np.float64(reward) / (1 - discount))
    if not np.abs(value) < np.finfo(np.float64).max / 1e3:
        raise ModelError(f"a reward of {reward:g} in every step is too large to add up: scale the rewards down")
    return value


def blind_values(dynamics: Dynamics, goes_on: Callable[[], bool] = lambda: True) -> Vector:
    """Return a lower bound of the value of each action, done for ever: A x S.

    Args:
        dynamics: The model; its discount is below 1.
        goes_on: Asked before each sweep; False ends them, and the other actions have rough bounds.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    ahead = dynamics.discount / (1 - dynamics.discount)
    close = _close(dynamics)
    for_ever(np.abs(dynamics.rewards).max(), dynamics.discount)
    result = np.empty((dynamics.num_actions, dynamics.num_states))
    for action, rewards in enumerate(dynamics.rewards.T):
        transition = dynamics.model.transition_matrix(action)
        values = change = rewards  # a sweep over zeros
        for _ in range(_BLIND_SWEEPS):
            if ahead * np.ptp(change) <= close or not goes_on():
                break
            backed = rewards + dynamics.discount * (transition @ values)
            change = backed - values
            values = backed
        # The limit exceeds the last sweep by at least so much, but for rounding.
        values = values + ahead * change.min()
        result[action] = values - _ROUNDING * np.abs(values).max()
    return result


def known_states(dynamics: Dynamics, gap: float) -> Iterator[tuple[Vector, bool]]:
    """Yield ever better values of actions in known states, S x A, and whether they are upper bounds.

    Args:
        dynamics: The model.
        gap: The last ones are so near to the optimal ones. With a discount of 1 only the last are bounds, and exact.

    Raises:
        ModelError: If the discount is 1, and the values have no bound.
    """
    if dynamics.discount == 1:
        for step in steps(dynamics):
            yield step.table, step.stable
        return
    for now in rounds(dynamics, sweeping(dynamics, gap, _EACH)):
        error = rounding(dynamics, now)
        yield dynamics.q_values(now.values) + now.above + error, True
        if now.above - now.below <= max(gap, error):
            return


def known_state_values(dynamics: Dynamics, goes_on: Callable[[], bool] = lambda: True) -> Vector:
    """Return an upper bound of the values of actions in known states, S x A.

    Args:
        dynamics: The model; its discount is below 1.
        goes_on: Asked after each round of sweeps; False ends them.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    for_ever(np.abs(dynamics.rewards).max(), dynamics.discount)
    found = known_states(dynamics, _close(dynamics))
    table, _ = next(found)
    while goes_on() and (better := next(found, None)) is not None:
        table, _ = better
    return table


def staged_values(dynamics: Dynamics, horizon: int) -> Vector:
    """Return the values of known states with so many decisions to go: S."""
    values = np.zeros(dynamics.num_states)
    for _ in range(horizon):
        values = dynamics.q_values(values).max(axis=1)
    return values


def informed_values(dynamics: Dynamics, limits: Limits, bound: InformedBound | None = None) -> Vector:
    """Return the fast informed bound, S x A, as near to its limit as a part of the time allows.

    Args:
        dynamics: A POMDP; its discount is below 1.
        limits: When to stop.
        bound: The backups, where some observations are left out.

    Raises:
        ModelError: If the rewards are too large for numbers.
    """
    if limits.remaining <= 0:
        most = for_ever(dynamics.rewards.max(), dynamics.discount)
        return np.full(dynamics.rewards.shape, most + _ROUNDING * abs(most))
    table = known_state_values(dynamics, limits.part(_KNOWN_TIME))
    return (InformedBound(dynamics) if bound is None else bound).lowered(table, limits.part(_INFORMED_TIME))


def _close(dynamics: Dynamics) -> float:
    rewards = dynamics.rewards
    return _CLOSE * float(np.ptp(rewards) + _CLOSE * np.abs(rewards).max()) / (1 - dynamics.discount)


class InformedBound:
    """Backups of the fast informed bound.

    Large models are swept by a compiled kernel where there is numba, each vector by the newest of the others
    (Gauss-Seidel); others by products of matrices, all at once.

    Args:
        dynamics: A POMDP.
        joints: P(s', o | s, a) of each action, where it is not the model's own.
        waiting: Moves values back along the steps of an action without a detection, from the step that ends in one; by
            default there are no such steps.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        joints: Sequence[Joint] | None = None,
        waiting: Callable[[int, Vector], Vector] | None = None,
    ) -> None:
        self._dynamics = dynamics
        self._waiting = waiting
        self._joints = joints
        self._sweep: Callable[[Vector], float] = self._sweep_at_once
        if joints is None and waiting is None and dynamics.entries * dynamics.num_actions > _LARGE and can_compile():
            self._sweep = self._compiled()

    def backup(self, table: Vector) -> Vector:
        """Return the vectors of one decision more, S x A."""
        dynamics = self._dynamics
        if self._joints is None:
            self._joints = [dynamics.joint(action) for action in range(dynamics.num_actions)]
        result = np.empty_like(table)
        for action, joint in enumerate(self._joints):
            ahead = np.bincount(joint.states, (joint.rows @ table).max(axis=1), minlength=dynamics.num_states)
            values = dynamics.rewards[:, action] + dynamics.discount * ahead
            result[:, action] = values if self._waiting is None else self._waiting(action, values)
        return result

    def sweep(self, table: Vector) -> float:
        """Lower upper bounds, S x A, in place; return the greatest change."""
        return self._sweep(table)

    def lowered(self, table: Vector, goes_on: Callable[[], bool]) -> Vector:
        """Return vectors lowered by sweeps until they are near the limit, or until it may not go on.

        Args:
            table: Upper bounds, S x A.
            goes_on: Asked before each sweep; False ends them.
        """
        discount = self._dynamics.discount
        table = np.array(table, order="C")
        while goes_on():
            change = self.sweep(table)
            # A sweep shrinks the distance to the limit at least by the discount.
            scale = float(np.ptp(table)) + _CLOSE * float(np.abs(table).max())
            if change * discount <= _INFORMED_CLOSE * scale * (1 - discount):
                break
        return table

    def _sweep_at_once(self, table: Vector) -> float:
        lower = np.minimum(self.backup(table), table)
        change = float((table - lower).max())
        table[:] = lower
        return change

    def _compiled(self) -> Callable[[Vector], float]:
        from mdm.solvers.mdp.sweeps import informed_sweep, scratch  # noqa: PLC0415 - imports numba

        dynamics = self._dynamics
        room = scratch(dynamics.num_observations, dynamics.num_actions)

        def sweep(table: Vector) -> float:
            return informed_sweep(
                dynamics.transitions,
                dynamics.observations,
                dynamics.by_transition,
                dynamics.rewards,
                dynamics.discount,
                table,
                room,
            )

        return sweep


# -- Their policies ----------------------------------------------------------------------------------------------------

_CHANGES = 1e-14
"""Backups go on while they change the vectors by more than this share."""
_SETTLED = 1e-3
"""With a discount of 1, backups end when they change vectors by less than this share of the gap."""


@makes(AlphaVectors)
def qmdp(model: MDP, *, limits: Limits | None = None) -> Solution:
    """Return the values of a POMDP's actions in known states, as `AlphaVectors`, one per action.

    Args:
        model: The model; factored ones are flattened.
        limits: When to stop; the gap is how far the vectors may be from their limit, and the iterations are rounds of
            sweeps, or policies where the discount is 1.

    Returns:
        The vectors, which are an upper bound. Nothing is proven of their policy's value: ``lower`` is -inf. With a
        discount of 1 they are a bound only when they are exact; before, ``upper`` is inf.

    Raises:
        ModelError: If the discount is 1, and the values have no bound; or the model has false negatives.
    """
    check_no_false_negatives(model, "QMDP")
    return _solved(model, limits, "qmdp", known_states)


@makes(AlphaVectors)
def fast_informed_bound(model: POMDP, *, limits: Limits | None = None) -> Solution:
    """Return an upper bound of a POMDP's value function as `AlphaVectors`, one per action.

    Args:
        model: The model, with observations of either kind; factored ones are flattened. Where observations of events do
            not sum to 1, the rest counts as one more observation.
        limits: When to stop; the gap is how far the vectors may be from their limit, and the iterations are backups,
            those for QMDP's vectors included.

    Returns:
        The vectors, which are an upper bound. Nothing is proven of their policy's value: ``lower`` is -inf. With a
        discount of 1 they are a bound only once QMDP's are exact; before, ``upper`` is inf.

    Raises:
        ModelError: If the discount is 1, and the values have no bound; or the model has false negatives.
    """
    check_no_false_negatives(model, "the fast informed bound")
    return _solved(model, limits, "fib", _vectors)


def _solved(
    model: MDP,
    limits: Limits | None,
    solver: str,
    vectors: Callable[[Dynamics, float], Iterator[tuple[Vector, bool]]],
) -> Solution:
    """Return the last vectors within the limits; ``vectors`` yields them, and whether they are bounds, for a gap."""
    with Limits() if limits is None else limits as run:
        dynamics = Dynamics(model)
        count, belief = dynamics.num_actions, model.initial_belief
        for iterations, (table, bounds) in enumerate(vectors(dynamics, run.gap), 1):
            upper = float((belief @ table).max()) if bounds else np.inf
            if run.ends(-np.inf, upper, iterations=iterations, size=count):
                break
        else:
            run.reason = "exact" if solver == "qmdp" and dynamics.discount == 1 else "converged"
        policy = AlphaVectors(table.T, range(count), count)
        return run.solution(policy, solver, -np.inf, upper, iterations=iterations, size=count)


def _vectors(dynamics: Dynamics, gap: float) -> Iterator[tuple[Vector, bool]]:
    """Yield vectors, S x A, ever lower, and whether they are bounds."""
    for table, bounds in known_states(dynamics, gap):
        yield table, bounds
    informed, table = InformedBound(dynamics), table.copy()
    slowness = dynamics.discount / (1 - dynamics.discount) if dynamics.discount < 1 else 1 / _SETTLED
    change = np.inf
    while slowness * change > gap and change > _CHANGES * np.abs(table).max():
        change = informed.sweep(table)
        yield table, True
