"""Two robots on a few cells: they are to meet, or to drill and sample together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP, Factor, Space
from mdm.problems.parameters import agents, checked

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector

_STEPS = {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}


@checked
def grid_small(success: float = 0.6, *, discount: float = 0.9) -> POMDP:
    """Return meeting in a grid of 2 x 2 cells, where a robot sees on which of its sides there is a wall.

    A step goes where it is meant to with probability ``success``; otherwise it goes to one of the other sides, or
    nowhere, all alike. A step into a wall goes nowhere. The robots earn 1 for each step that ends with both in one
    cell, and see whether they are in the left column (``nnnnnynnn``, the way to the right is free) or in the right one
    (``nnnynnnnn``). They begin in opposite corners.

    16 states, 5 x 5 actions, 2 x 2 observations. Optimal values of decentralised plans without discount: 0.91 for 2
    decisions, 1.55044 for 3, 2.24158 for 4, 2.97050 for 5, 3.71717 for 6.

    Source: D. S. Bernstein, E. A. Hansen and S. Zilberstein, *Bounded policy iteration for decentralized POMDPs*, IJCAI
    2005, with two observations as in C. Amato, D. S. Bernstein and S. Zilberstein, *Optimal fixed-size controllers for
    decentralized POMDPs*, MSDM 2006. Values: F. A. Oliehoek, M. T. J. Spaan, C. Amato and S. Whiteson, *Incremental
    clustering and expansion for faster optimal planning in Dec-POMDPs*, JAIR 46, 2013.

    Args:
        success: The probability that a step goes where it is meant to.
        discount: In (0, 1].
    """
    transitions = _transitions(2, success)
    met = np.eye(4).ravel()
    column = np.tile(np.eye(2), (2, 1))
    return POMDP(
        transitions,
        [np.kron(column, column)] * 25,
        np.stack([transition @ met for transition in transitions], axis=1),
        discount=discount,
        states=_positions(2),
        actions=agents([*_STEPS, "stay"]),
        observation_names=agents(["nnnnnynnn", "nnnynnnnn"]),
        initial_belief=_apart(2),
    )


@checked
def meeting(size: int = 3, *, success: float = 0.6, discount: float = 1.0) -> POMDP:
    """Return meeting in one of two corners of a square grid, where a robot sees in which cell it is.

    Steps are those of `grid_small`. The robots earn 1 for each step that they begin together in the upper left corner
    or together in the lower right one. They begin in the two other corners.

    size^4 states, 5 x 5 actions, size^2 x size^2 observations. Optimal values of decentralised plans in the grid of 3 x
    3 cells: 0 for 2 decisions, 0.1332 for 3.

    Source: C. Amato, J. S. Dibangoye and S. Zilberstein, *Incremental policy generation for finite-horizon
    DEC-POMDPs*, ICAPS 2009.

    Args:
        size: Rows and columns of the grid.
        success: The probability that a step goes where it is meant to.
        discount: In (0, 1].

    Raises:
        ModelError: If the grid has less than 2 x 2 cells.
    """
    if size < 2:
        raise ModelError(f"a grid to meet in has at least 2 rows and columns, not {size}")
    from scipy import sparse  # noqa: PLC0415 - slow to import

    cells = size * size
    corners = np.zeros((cells, cells))
    corners[0, 0] = corners[-1, -1] = 1
    return POMDP(
        _transitions(size, success),
        [sparse.eye_array(cells * cells, format="csr")] * 25,
        np.tile(corners.reshape(-1, 1), 25),
        discount=discount,
        states=_positions(size),
        actions=agents([*_STEPS, "stay"]),
        observation_names=agents([f"obs{cell}" for cell in range(cells)]),
        initial_belief=_apart(size),
    )


def _transitions(size: int, success: float) -> list[Matrix]:
    """Return T of every joint action, as CSR: the robots move independently, and may share a cell."""
    from scipy import sparse  # noqa: PLC0415 - slow to import

    cells = size * size
    steps = np.zeros((4, cells, cells))  # where each step leads, were it certain
    for number, (down, right) in enumerate(_STEPS.values()):
        for row, column in np.ndindex(size, size):
            to_row, to_column = row + down, column + right
            inside = 0 <= to_row < size and 0 <= to_column < size
            to = to_row * size + to_column if inside else row * size + column
            steps[number, row * size + column, to] = 1
    other = (1 - success) / 4
    astray = other * (np.eye(cells) + steps.sum(axis=0))
    moves = [*(astray + (success - other) * steps), np.eye(cells)]
    few = [sparse.csr_array(move) for move in moves]
    return [sparse.kron(first, second, format="csr") for first in few for second in few]


def _positions(size: int) -> Space:
    return Space(Factor(f"position{robot}", size * size, prefix="cell") for robot in range(2))


def _apart(size: int) -> Vector:
    """Return the belief that the first robot is in the upper right corner, the other in the lower left one."""
    belief = np.zeros((size * size, size * size))
    belief[size - 1, -size] = 1
    return belief.ravel()


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
    the last site has been worked at, all starts again. Each rover sees where it is and whether that site has been
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
    """Return the reward of two rovers."""
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
