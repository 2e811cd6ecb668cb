"""The smallest change of a belief by which a policy of alpha vectors would have decided otherwise.

A change is measured by the probability that it moves between states: half the L1 distance of two beliefs. For each
vector v of another action, the nearest belief at which it is as good as every vector of the chosen action solves a
linear program: with b' = b + p - q,

    minimise sum p   subject to   sum p = sum q,  0 <= q <= b,  0 <= p,  (v - w) . b' >= e  for each w of the action,

where e is so small that it only decides ties. The nearest of all vectors is the answer. It is exact, but for the
solver's precision (1e-9 of the values' size). Constraints are added as they are found broken, and vectors are taken in
the order of a bound from one constraint alone, for which moving from the worst states to the best one is optimal; most
programs are never solved. Cost: N x S for the bounds, and linear programs of 2S variables.
"""

from __future__ import annotations

from functools import singledispatch
from itertools import combinations
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import scipy

from mdm.errors import ModelError
from mdm.policies import AlphaVectors, MaskedAlphaVectors, MixedAlphaVectors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models.matrices import Vector

    Mask = npt.NDArray[np.bool_]

_LARGEST = 2_000_000
"""Vectors times states up to which programs are solved."""
_GREATEST = 1e100
"""Values from which sums of differences would overflow."""
_PRECISE = 1e-10
"""The solver's tolerance: the least that HiGHS takes."""
_TIES = (1e-9, 0.0, 1e-7)
"""By how much of the values' size another action is to be better, tried in turn.

Of equal ones the first action is chosen, so that to be as good may be enough; rounding may take a little more."""
_SUPPORT = 1.5e-10
"""A probability that counts as one for masked vectors, and next to nothing else."""
_BREAKING, _MOST_BREAKING = 50, 3
"""How many states may break masks, and how many of them at once."""


class Move(msgspec.Struct, frozen=True):
    """A state's probability, before and after a change."""

    state: str
    before: float
    after: float


class BeliefChange(msgspec.Struct, frozen=True, tag="belief"):
    """The smallest change of a belief that would have decided otherwise.

    Attributes:
        mass: The probability that would have to lie elsewhere: half the L1 distance.
        moves: The states whose probability changes, the greatest change first.
        action: The name of the action that would have been chosen.
    """

    mass: float
    moves: tuple[Move, ...]
    action: str


def moved(one: Vector, other: Vector) -> float:
    """Return the probability that lies elsewhere in another belief: half the L1 distance."""
    return float(np.abs(one - other).sum() / 2)


@singledispatch
def nearest_belief(policy: Any, belief: Vector) -> Vector | None:
    """Return the nearest belief at which a policy decides otherwise; None where it does so nowhere.

    Args:
        policy: The policy: alpha vectors, masked ones, or ones for each observed value.
        belief: S numbers.

    Raises:
        ModelError: If it cannot be computed for a policy of this kind or size; a sentence says why.
    """
    form = getattr(policy, "form", type(policy).__name__)
    raise ModelError(f"the nearest belief of {len(belief)} states that decides otherwise cannot be computed for {form}")


@nearest_belief.register(AlphaVectors)
def _alpha(policy: AlphaVectors, belief: Vector) -> Vector | None:
    _check_size(policy.vectors.shape)
    action = policy.action(belief)
    _check_numbers(policy.vectors)
    actions = np.asarray(policy.actions)
    own, rivals = policy.vectors[actions == action], policy.vectors[actions != action]
    decides = _otherwise(policy, action)
    best, least = None, np.inf
    for bound, rival in _by_bound(belief, rivals, own):
        if bound >= least:
            break
        for tie in _TIES:
            after = _program(belief, rival, own, None, tie)
            if after is not None and decides(after):
                if moved(belief, after) < least:
                    best, least = after, moved(belief, after)
                break
    return best


@nearest_belief.register(MixedAlphaVectors)
def _mixed(policy: MixedAlphaVectors, belief: Vector) -> Vector | None:
    """Stay within the observed value, or move half of the probability to another one, which then decides the vote."""
    action = policy.action(belief)
    masses = belief[policy.states].sum(axis=1)
    (open_,) = np.nonzero(masses)
    if len(open_) > 1:
        raise ModelError("the policy votes, since the belief leaves open what is observed: only values are given")
    x = int(open_[0])
    vectors, places = policy.sets[x], policy.states[x]
    assert vectors is not None
    found = []
    within = nearest_belief(vectors, belief[places])
    if within is not None:
        found.append(_placed(within, places, len(belief)))
    for other, others in enumerate(policy.sets):
        if other == x or others is None:
            continue
        first: Vector = np.eye(others.num_states)[0]
        hidden = first if others.action(first) != action else nearest_belief(others, first)
        if hidden is not None:
            kept = 0.5 - _TIES[0]  # whichever of equal votes would win, and whatever rounding adds
            found.append(kept * belief + (1 - kept) * _placed(hidden, policy.states[other], len(belief)))
    decides = _otherwise(policy, action)
    return min(filter(decides, found), key=lambda after: moved(belief, after), default=None)


@nearest_belief.register(MaskedAlphaVectors)
def _masked(policy: MaskedAlphaVectors, belief: Vector) -> Vector | None:
    """Vectors of the action hold only within their masks.

    One whose mask is not all of a rival's need not be worse than the rival: a state of the rival's mask outside of its
    own, with next to no probability, is enough.
    """
    shape = (len(policy.vectors), policy.num_states)
    _check_size(shape)
    action = policy.action(belief)
    values, masks = np.zeros(shape), np.zeros(shape, dtype=bool)
    for row, vector in enumerate(policy.vectors):
        values[row, list(vector)] = list(vector.values())
        masks[row, list(vector)] = True
    _check_numbers(values)
    actions = np.asarray(policy.actions)
    own, own_masks = values[actions == action], masks[actions == action]
    others, other_masks = values[actions != action], masks[actions != action]
    decides = _otherwise(policy, action)
    order = np.argsort(belief @ ~other_masks.T, kind="stable")
    best, least = None, np.inf
    for rival, mask in zip(others[order], other_masks[order], strict=True):
        if belief[~mask].sum() > least:
            break
        for tie in _TIES:
            ways = list(filter(decides, _ways(belief, rival, mask, own, own_masks, tie)))
            if ways:
                nearest = min(ways, key=lambda after: moved(belief, after))
                if moved(belief, nearest) < least:
                    best, least = nearest, moved(belief, nearest)
                break
    return best


def _ways(belief: Vector, rival: Vector, mask: Mask, own: Vector, own_masks: Mask, tie: float) -> Iterator[Vector]:
    """Yield beliefs near by at which a masked vector may be the best that holds."""
    always = ~(mask & ~own_masks).any(axis=1)
    after = _program(belief, rival, own[always], mask, tie)
    if after is None:
        return
    yield after
    # Those that hold there all the same, and are better, are to be broken by states of next to no probability.
    better = ~((after > _SUPPORT) & ~own_masks).any(axis=1) & ~always & (own @ after > rival @ after)
    lacking = ~own_masks[better]
    states = np.flatnonzero(mask & (after <= _SUPPORT) & lacking.any(axis=0))[:_BREAKING].tolist()
    for count in range(1, _MOST_BREAKING + 1):
        breaking = [each for each in combinations(states, count) if lacking[:, list(each)].any(axis=1).all()]
        if breaking and len(lacking):
            broken = after.copy()
            broken[list(breaking[0])] += _SUPPORT
            broken[after.argmax()] -= count * _SUPPORT
            yield broken
            break
    whole = _program(belief, rival, own, mask, tie)
    if whole is not None:
        yield whole


def _otherwise(policy: Any, action: int) -> Callable[[Vector], bool]:
    def decides(belief: Vector) -> bool:
        try:
            return bool(policy.action(belief) != action)
        except ModelError:
            return False

    return decides


def _by_bound(belief: Vector, rivals: Vector, own: Vector) -> list[tuple[float, Vector]]:
    """Return vectors in the order of the least probability to be moved if only the best own vector counted."""
    if not len(own):
        return [(0.0, rival) for rival in rivals]
    top = own[(own @ belief).argmax()]
    (support,) = belief.nonzero()
    found = []
    for rival in rivals:
        ahead = rival - top
        most = ahead.max()
        worst = support[np.argsort(ahead[support], kind="stable")]
        gains, masses = most - ahead[worst], belief[worst]
        missing = -float(ahead @ belief)
        if missing <= 0:
            found.append((0.0, rival))
            continue
        gained = np.cumsum(gains * masses)
        last = int(np.searchsorted(gained, missing))
        if last == len(worst) or most < 0:
            continue  # it is nowhere better
        before = gained[last - 1] if last else 0.0
        found.append((float(masses[:last].sum() + (missing - before) / gains[last]), rival))
    return sorted(found, key=lambda pair: pair[0])


def _program(belief: Vector, rival: Vector, own: Vector, mask: Any, tie: float) -> Vector | None:
    """Return the nearest belief at which a vector is better than others, by ``tie`` of their size; None without one.

    Args:
        belief: S numbers.
        rival: The vector.
        own: The vectors that it is to be better than.
        mask: The states that the new belief may have; by default all.
        tie: By how much it is to be better, in parts of the values' size.
    """
    size = len(belief)
    allowed = np.ones(size, dtype=bool) if mask is None else mask
    ahead = rival - own
    scale = np.abs(ahead).max(axis=1, initial=0.0, keepdims=True)
    ahead = ahead / np.where(scale > 0, scale, 1.0)
    bounds = np.concatenate(
        [
            np.stack([np.zeros(size), np.where(allowed, np.inf, 0.0)], axis=1),
            np.stack([np.where(allowed, 0.0, belief), belief], axis=1),
        ]
    )
    cost = np.concatenate([np.ones(size), np.zeros(size)])
    balance = np.concatenate([np.ones(size), -np.ones(size)])[None]
    active = [int((ahead @ belief).argmin())] if len(own) else []
    while True:
        rows = ahead[active]
        solved = scipy.optimize.linprog(
            cost,
            A_ub=np.concatenate([-rows, rows], axis=1) if active else None,
            b_ub=rows @ belief - tie if active else None,
            A_eq=balance,
            b_eq=[0.0],
            bounds=bounds,
            method="highs",
            options={"primal_feasibility_tolerance": _PRECISE, "dual_feasibility_tolerance": _PRECISE},
        )
        if solved.x is None or solved.status != 0:
            return None
        after: Vector = np.maximum(belief + solved.x[:size] - solved.x[size:], 0.0)
        after[~allowed] = 0.0
        after /= after.sum()
        if not len(own):
            return after
        worst = int((ahead @ after).argmin())
        if worst in active or ahead[worst] @ after >= tie / 2:
            return after
        active.append(worst)


def _placed(part: Vector, places: Vector, size: int) -> Vector:
    whole: Vector = np.zeros(size)
    whole[places] = part
    return whole


def _check_size(shape: tuple[int, ...]) -> None:
    if shape[0] * shape[1] > _LARGEST:
        raise ModelError(
            f"the policy has {shape[0]} vectors over {shape[1]} states: the nearest belief that decides otherwise is "
            f"computed for at most {_LARGEST:,} numbers"
        )


def _check_numbers(values: Vector) -> None:
    if np.abs(values).max() > _GREATEST:
        raise ModelError(f"the nearest belief that decides otherwise is not computed for values above {_GREATEST:g}")
