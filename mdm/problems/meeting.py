"""Two robots that are to meet on a grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models import POMDP, Factor, Space
from mdm.problems.parameters import agents, checked

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix, Vector

__all__ = ["grid_small", "meeting"]

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
