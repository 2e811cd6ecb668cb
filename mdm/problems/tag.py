"""Tag: a robot that catches another one, which runs away."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models import Factor, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.problems.grid import Grid
from mdm.problems.parameters import checked

__all__ = ["tag"]

_FIELD = """
     ...
     ...
     ...
..........
..........
"""
# The robot's actions, by where the grid has what lies beside a cell: north, south, east, west.
_MOVES = {"north": 0, "south": 2, "east": 1, "west": 3}
_CATCH = len(_MOVES)


@checked
def tag(field: str = _FIELD, *, discount: float = 0.95) -> FactoredPOMDP:
    """Return tag: a robot is to catch a target, which it sees only from the same cell.

    The robot knows its own cell and moves without errors. The target stays with probability 0.2, and moves along each
    axis with probability 0.4: away from the robot, or to a random side if the robot is on neither. A step pays -1,
    catching 10 in the target's cell, where the problem ends, and -10 elsewhere. After the end, catching pays nothing,
    but every step still pays -1.

    870 states (29 cells x 29 cells and the end), 5 actions, 30 observations. The robot's cell is a fully observed
    factor. The cells count from the south-west, row by row.

    Source: J. Pineau, G. Gordon and S. Thrun, *Point-based value iteration: an anytime algorithm for POMDPs*,
    International Joint Conference on Artificial Intelligence, 2003, section 5; rewards after the end as in the files of
    the SARSOP solver.

    Args:
        field: A line a row, the northernmost first, or rows with ``/`` between; a blank or ``#`` is a wall, every other
            character a cell.
        discount: In (0, 1].
    """
    grid = Grid(field)
    # From the southernmost row on, each row from the west.
    order = sorted(range(len(grid)), key=lambda cell: (-grid.places[cell][0], grid.places[cell][1]))
    beside = np.argsort(order)[grid.beside[order]]
    places = np.array(grid.places)[order]
    names = [grid.names[cell] for cell in order]
    size = len(names)
    if size < 2:
        raise ModelError("the field has a single cell; two robots need more")
    uniform = np.full(size, 1 / size)
    robot, target = Node("state", 0), Node("state", 1)
    robot_then, target_then = Node("next_state", 0), Node("next_state", 1)
    action, seen = Node("action", 0), Node("observation", 0)
    moves = [np.eye(size)[beside[:, side]] for side in _MOVES.values()]
    actions = [*_MOVES, "catch"]
    fled = _flight(beside, places)
    caught = np.broadcast_to(np.eye(size + 1), (size, size + 1, size + 1)).copy()
    caught[np.arange(size), np.arange(size)] = np.eye(size + 1)[size]
    sight = np.broadcast_to(np.eye(size, size + 1)[:, None], (size, size + 1, size + 1)).copy()
    sight[np.arange(size), np.arange(size)] = np.eye(size + 1)[size]
    catch_pays = np.full((size, size + 1), -10.0)
    catch_pays[:, :size][np.eye(size, dtype=bool)] = 10
    catch_pays[:, size] = 0
    is_catch = [0] * _CATCH + [1]
    network = TwoSliceNetwork(
        Space([Factor("robot", names), Factor("target", [*names, "tagged"])]),
        Space.single("robot", actions),
        Space.single("robot", [*names, "target"]),
        initial=[Table([robot], uniform), Table([target], np.r_[uniform, 0.0])],
        transitions=[
            Tree(
                target,
                [0] * size + [1],
                [Table([action, robot, robot_then], [*moves, np.eye(size)]), Table([robot, robot_then], np.eye(size))],
            ),
            Tree(
                action,
                is_catch,
                [Table([robot, target, target_then], fled), Table([robot, target, target_then], caught)],
            ),
        ],
        observation=[
            # Nobody is caught without being tagged: what is seen then can only be the robot's own cell.
            Tree(
                action,
                is_catch,
                [Table([robot_then, target_then, seen], sight), Table([robot_then, seen], np.eye(size, size + 1))],
            )
        ],
        utilities=[Tree(action, is_catch, [Table([robot], np.full(size, -1.0)), Table([robot, target], catch_pays)])],
        fully_observed=[True, False],
    )
    return FactoredPOMDP(network, discount=discount)


def _flight(beside: npt.NDArray[np.intp], places: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
    """Return the distribution of the target's next cell, given the robot's and its own: cells x cells + 1 x cells + 1.

    The last of a target's cells is the end.
    """
    size = len(beside)
    rows, columns = places.T
    chances = np.zeros((size, size + 1, size + 1))
    chances[:, :size, :size] += 0.2 * np.eye(size)
    chances[:, size, size] = 1
    # Rows count from the north: a target with a lower row than the robot goes on to the north.
    further = np.sign(rows - rows[:, None]), np.sign(columns - columns[:, None])  # robot x target
    for side, ahead in ((0, -further[0]), (2, further[0]), (1, further[1]), (3, -further[1])):
        chance = np.choose(ahead + 1, [0.0, 0.2, 0.4])
        reached = np.eye(size)[beside[:, side]]
        chances[:, :size, :size] += chance[:, :, None] * reached
    return chances
