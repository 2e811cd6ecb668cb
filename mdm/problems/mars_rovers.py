"""Mars rovers: two rovers that drill or sample at four sites."""

from __future__ import annotations

import math

import numpy as np

from mdm.models import POMDP, Factor, Space
from mdm.problems.parameters import agents, checked

__all__ = ["mars_rovers"]

_UP, _DOWN, _LEFT, _RIGHT, _DRILL, _SAMPLE = range(6)
_SITES = 4
_HARD = (0, 3)
"""The sites that take two drills."""
_NEXT = {  # where each move leads: the sites lie in a square, 0 and 2 above 1 and 3
    _UP: (0, 0, 2, 2),
    _DOWN: (1, 1, 3, 3),
    _LEFT: (0, 1, 0, 1),
    _RIGHT: (2, 3, 2, 3),
}
_ALONE = {_DRILL: -10.0, _SAMPLE: 2.0}
_AGAIN, _MOVE = -1.0, -0.1


@checked
def mars_rovers(success: float = 0.9, *, discount: float = 1.0) -> POMDP:
    """Return the problem of two rovers on Mars, who visit four sites to drill or to take samples.

    Two sites are to be drilled by both rovers at once, which pays 6; at the two others a sample is enough. Drilling
    alone spoils a site, and costs 10; a sample pays 2. Work at a site that has been worked at costs 1, a move 0.1. When
    the last site has been worked at, everything starts anew. Each rover sees where it is and whether this site has been
    worked at.

    256 states, 6 x 6 actions, 8 x 8 observations. Optimal values of decentralised plans: 5.80 for 2 decisions, 9.38 for
    3, 10.18 for 4.

    Source: C. Amato and S. Zilberstein, *Achieving goals in decentralized POMDPs*, AAMAS 2009, with the numbers of the
    MADP toolbox. There, where both rovers work at different sites, what the first one does counts for both. Values: F.
    A. Oliehoek, M. T. J. Spaan, C. Amato and S. Whiteson, *Incremental clustering and expansion for faster optimal
    planning in Dec-POMDPs*, JAIR 46, 2013.

    Args:
        success: The probability that a move leads anywhere.
        discount: In (0, 1].
    """
    moves = np.stack([np.eye(_SITES)] * 6)
    for move, targets in _NEXT.items():
        moves[move] *= 1 - success
        moves[move, np.arange(_SITES), targets] += success
    shape = (_SITES, _SITES, 2**_SITES)
    size, finished = math.prod(shape), 2**_SITES - 1
    transitions, rewards, seen = [], np.zeros((*shape, 6, 6)), np.zeros((*shape, 8, 8))
    for actions in np.ndindex(6, 6):
        transition = np.zeros((*shape, *shape))
        for first, second, worked in np.ndindex(shape):
            rewards[(first, second, worked, *actions)] = _reward(actions, (first, second), worked)
            active = [site for site, action in zip((first, second), actions, strict=True) if action >= _DRILL]
            after = worked | sum({1 << site for site in active})
            if active and after == finished:
                transition[first, second, worked, 0, 0, 0] = 1
            else:
                arrivals = np.outer(moves[actions[0], first], moves[actions[1], second])
                transition[first, second, worked, :, :, after] = arrivals
        transitions.append(transition.reshape(size, size))
    for first, second, worked in np.ndindex(shape):
        told = (site + _SITES * (worked >> site & 1) for site in (first, second))
        seen[(first, second, worked, *told)] = 1
    return POMDP(
        transitions,
        [seen.reshape(size, 64)] * 36,
        rewards.reshape(size, 36),
        discount=discount,
        states=Space(
            [
                *(Factor(f"site{rover}", [f"s{site}" for site in range(_SITES)]) for rover in range(2)),
                *(Factor(f"worked{site}", ["no", "yes"]) for site in reversed(range(_SITES))),
            ]
        ),
        actions=agents(["up", "down", "left", "right", "drill", "sample"]),
        observation_names=agents(
            [*(f"s{site}notSampled" for site in range(_SITES)), *(f"s{site}sampled" for site in range(_SITES))]
        ),
        initial_belief=np.eye(size)[0],
    )


def _reward(actions: tuple[int, ...], sites: tuple[int, ...], worked: int) -> float:
    """Return what two rovers earn."""
    works = [action in (_DRILL, _SAMPLE) for action in actions]
    again = [bool(worked >> site & 1) for site in sites]
    if not all(works):
        alone = [_AGAIN if before else _ALONE.get(action, 0) for action, before in zip(actions, again, strict=True)]
        return sum(each if active else _MOVE for each, active in zip(alone, works, strict=True))
    if all(again):
        return 2 * _AGAIN
    if sites[0] != sites[1]:
        # As in the file of the MADP toolbox, by the first rover's work alone.
        if any(again):
            return _ALONE[actions[0]] + _AGAIN
        return 0 if actions[0] == _DRILL else 2 * _ALONE[_SAMPLE]
    if actions == (_DRILL, _DRILL):
        return 6 if sites[0] in _HARD else 0
    if actions == (_SAMPLE, _SAMPLE):
        return 1 if sites[0] in _HARD else _ALONE[_SAMPLE]
    return 0
