"""The beliefs of Perseus: those that random actions lead to, each once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ConfigError
from mdm.models.matrices import distribution

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy.typing as npt

    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP
    from mdm.solvers.joint_dynamics import JointDynamics
    from mdm.solvers.solution import Limits

__all__ = ["sampled", "starts"]

_DIGITS = 7
"""Beliefs that agree to so many digits are one."""
_TRIES = 20
"""The most steps for each belief asked for."""
_COPIES = 8 * 8
"""Bytes that are reserved for each number of a belief: what a round computes at all beliefs is as large as they are."""
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
        dynamics: What its actions lead to.
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
