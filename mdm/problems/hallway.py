"""The hallway problems: robot navigation with landmarks."""

from __future__ import annotations

import string

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models import POMDP, Factor, Space
from mdm.problems.grid import DIRECTIONS, Grid
from mdm.problems.parameters import checked

__all__ = ["hallway", "hallway2"]

_HALLWAY = """
    ..a.b.c.d..
      . . . +
"""
_HALLWAY_2 = """
     .....
    .. . ..
     . . .
    .. . .+
     .....
"""
_ACTIONS = ("stay", "forward", "turn-right", "turn-around", "turn-left")
_SIDES = ("front", "right", "back", "left")
# How many quarters to the right a turn ends, and how likely, in the order of the actions from the third on.
_TURNS = ((0.1, 0.7, 0.1, 0.1), (0.1, 0.15, 0.6, 0.15), (0.1, 0.1, 0.1, 0.7))
_WALL_SEEN, _WALL_IMAGINED = 0.9, 0.05


@checked
def hallway(maze: str = _HALLWAY, *, discount: float = 0.95) -> POMDP:
    """Return the hallway problem: a robot in a corridor finds a goal by the walls around it and landmarks.

    The robot has a place and a heading. It stays, goes forward or turns by a quarter or two, all but the first with
    errors, and sees on which sides of it there are walls, with errors too. In a cell with a landmark, a robot facing
    south sees it for sure. In the goal, which is seen for sure, every action pays nothing and leads to a cell and
    heading at random; entering it pays 1.

    60 states (15 cells x 4 headings), 5 actions, 21 observations. Numbers that files of this problem round to six
    digits are exact here.

    Source: M. L. Littman, A. R. Cassandra and L. P. Kaelbling, *Learning policies for partially observable
    environments: scaling up*, International Conference on Machine Learning, 1995, section 5; with the goal as an
    observation of its own, as in A. R. Cassandra's files.

    Args:
        maze: A line a row, the northernmost first, or rows with ``/`` between: ``.`` is a cell, ``+`` a goal, ``a`` to
            ``z`` a cell with a landmark on its south, each another one; a blank or ``#`` is a wall.
        discount: In (0, 1].

    Raises:
        ModelError: If the maze has no goal, no other cell, or an unknown character.
    """
    grid = Grid(maze)
    unknown = set(grid.marks) - set(f".+{string.ascii_lowercase}")
    if unknown:
        raise ModelError(f"{min(unknown)!r} in the maze is neither '.', '+' nor a letter from a to z")
    goals = np.repeat(grid.marked("+"), 4)
    if not goals.any() or goals.all():
        raise ModelError("the maze needs a goal '+' and a cell that is none")
    start = ~goals / (~goals).sum()
    landmarks = sorted(set(grid.marks) - set(".+"))
    turns = [[np.roll(chances, heading) for heading in range(4)] for chances in _TURNS]
    moves = [np.eye(len(goals)), _forward(grid), *(np.kron(np.eye(len(grid)), turn) for turn in turns)]
    for matrix in moves:
        matrix[goals] = start
    entered = np.broadcast_to(goals.astype(float), (len(moves), len(goals), len(goals)))
    walls = [
        "-".join(side for side, wall in zip(_SIDES, bits, strict=True) if wall) or "no-wall"
        for bits in np.ndindex(2, 2, 2, 2)
    ]
    return POMDP(
        moves,
        [_sight(grid, landmarks)] * len(moves),
        entered,
        discount=discount,
        states=Space([Factor("cell", grid.names), Factor("heading", DIRECTIONS)]),
        actions=_ACTIONS,
        observation_names=[*walls, *(f"landmark-{mark}" for mark in landmarks), "goal"],
        initial_belief=start,
    )


@checked
def hallway2(*, discount: float = 0.95) -> POMDP:
    """Return the second hallway problem: a larger maze than that of `hallway`, without landmarks.

    92 states (23 cells x 4 headings), 5 actions, 17 observations.

    Source: as for `hallway`.

    Args:
        discount: In (0, 1].
    """
    return hallway(_HALLWAY_2, discount=discount)


def _forward(grid: Grid) -> npt.NDArray[np.float64]:
    """Return T of going forward: also to the sides and back, where the robot may end up with another heading."""
    matrix = np.zeros((4 * len(grid), 4 * len(grid)))
    for cell, beside in enumerate(grid.beside):
        for heading in range(4):
            row = matrix[4 * cell + heading]
            # By how many quarters the move is off the heading, how likely it is, and what headings it ends in.
            for off, chance, turned in ((0, 0.8, (0,)), (1, 0.05, (1,)), (2, 0.05, (0, 2)), (3, 0.05, (3,))):
                next_cell = beside[(heading + off) % 4]
                if next_cell != cell:
                    for by in turned:
                        row[4 * next_cell + (heading + by) % 4] += chance / len(turned)
            row[4 * cell + heading] += 1 - row.sum()
    return matrix


def _sight(grid: Grid, landmarks: list[str]) -> npt.NDArray[np.float64]:
    """Return O: four walls or not, each seen with errors; landmarks and the goal for sure."""
    # Walls by cell, heading and side, where sides count from the heading on to the right.
    sides = (np.arange(4)[:, None] + np.arange(4)) % 4
    walls = grid.walls[:, sides].reshape(-1, 4)
    seen = np.where(walls, _WALL_SEEN, _WALL_IMAGINED)
    bits = np.indices((2, 2, 2, 2)).reshape(4, -1)  # the front is the most significant
    matrix = np.zeros((len(walls), bits.shape[1] + len(landmarks) + 1))
    matrix[:, : bits.shape[1]] = np.where(bits, seen[:, :, None], 1 - seen[:, :, None]).prod(axis=1)
    south = DIRECTIONS.index("south")
    for cell, mark in enumerate(grid.marks):
        if mark == "+":
            matrix[4 * cell : 4 * cell + 4] = np.eye(matrix.shape[1])[-1]
        elif mark in landmarks:
            matrix[4 * cell + south] = np.eye(matrix.shape[1])[bits.shape[1] + landmarks.index(mark)]
    return matrix
