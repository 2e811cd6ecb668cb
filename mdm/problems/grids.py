"""Robots on grids drawn as text: grid worlds, the hallway problems, tag."""

from __future__ import annotations

import string
import textwrap
from typing import Any

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models import MDP, POMDP, Factor, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.models.matrices import csr
from mdm.problems.parameters import checked

DIRECTIONS = ("north", "east", "south", "west")
_STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))
_WALLS = " #"


class Grid:
    """The cells of a map, row by row from the north, each row from the west.

    Args:
        text: A line a row, the northernmost first; ``/`` may stand for the end of a line. A blank or ``#`` is a wall,
            every other character a cell.

    Attributes:
        places: For each cell its row and column, from 0.
        marks: For each cell its character.
        beside: For each cell the cells to the north, east, south and west: a cells x 4 array. Where a wall or the edge
            of the map is, it is the cell itself.

    Raises:
        ModelError: If there is no cell.
    """

    def __init__(self, text: str) -> None:
        rows = textwrap.dedent(text.replace("/", "\n")).strip("\n").split("\n")
        found = {
            (row, column): mark
            for row, line in enumerate(rows)
            for column, mark in enumerate(line)
            if mark not in _WALLS
        }
        if not found:
            raise ModelError("the map has no cell; a cell is any character but a blank and '#'")
        self.places = tuple(found)
        self.marks = tuple(found.values())
        index = {place: number for number, place in enumerate(self.places)}
        self.beside: npt.NDArray[np.intp] = np.array(
            [
                [index.get((row + down, column + right), index[row, column]) for down, right in _STEPS]
                for row, column in self.places
            ],
            dtype=np.intp,
        )

    def __len__(self) -> int:
        return len(self.places)

    @property
    def walls(self) -> npt.NDArray[np.bool_]:
        """Whether there is a wall to the north, east, south and west of each cell: cells x 4."""
        return np.equal(self.beside, np.arange(len(self))[:, None])

    @property
    def names(self) -> list[str]:
        """A name for each cell, such as ``row0-column3``."""
        return [f"row{row}-column{column}" for row, column in self.places]

    def marked(self, marks: str) -> npt.NDArray[np.bool_]:
        """Return for each cell whether its character is one of some."""
        return np.array([mark in marks for mark in self.marks])


_RUSSELL_NORVIG = """
...+
.#.-
s...
"""


@checked
def grid_world(
    layout: str = _RUSSELL_NORVIG,
    *,
    slip: float = 0.2,
    step_reward: float = -0.04,
    goal_reward: float = 1.0,
    pit_reward: float = -1.0,
    discount: float = 1.0,
) -> MDP:
    """Return a grid world: an agent that goes north, east, south or west and may slip to either side.

    Against a wall it stays where it is. Every action in a goal or a pit pays for that cell and leads to the end, where
    nothing is paid any more; every other action pays the reward of a step.

    By default it is the 4 x 3 world of the textbook: 12 states (11 cells and the end), 4 actions. Its optimal values
    are, from the north-west: 0.812, 0.868, 0.918, 1; 0.762, 0.660, -1; 0.705, 0.655, 0.611, 0.388.

    Source: S. J. Russell and P. Norvig, *Artificial Intelligence: A Modern Approach*, 3rd edition, 2010, section 17.1.

    Args:
        layout: A line a row, the northernmost first, or rows with ``/`` between: ``.`` is a cell, ``+`` a goal, ``-`` a
            pit, ``s`` a cell where the agent may begin; a blank or ``#`` is a wall. Without an ``s`` it begins in any
            ``.``.
        slip: The probability of going to the left or to the right of where the action aims, half of it each.
        step_reward: The reward of an action outside goals and pits.
        goal_reward: The reward of an action in a goal.
        pit_reward: The reward of an action in a pit.
        discount: In (0, 1].

    Raises:
        ModelError: If the layout has an unknown character or no cell to begin in, or the slip is not a probability.
    """
    grid = Grid(layout)
    unknown = set(grid.marks) - set(".+-s")
    if unknown:
        raise ModelError(f"{min(unknown)!r} in the layout is none of '.', '+', '-' and 's'")
    if not 0 <= slip <= 1:
        raise ModelError(f"the slip is a probability, not {slip}")
    start = grid.marked("s" if "s" in grid.marks else ".")
    if not start.any():
        raise ModelError("the layout has no cell to begin in: neither '.' nor 's'")
    over = grid.marked("+-")
    rewards = np.where(grid.marked("+"), goal_reward, np.where(grid.marked("-"), pit_reward, step_reward))
    return MDP(
        [_move(grid, over, heading, slip) for heading in range(4)],
        np.r_[rewards, 0.0],
        discount=discount,
        states=[*grid.names, "end"],
        actions=DIRECTIONS,
        initial_belief=np.r_[start / start.sum(), 0.0],
    )


def _move(grid: Grid, over: npt.NDArray[np.bool_], heading: int, slip: float) -> Any:
    """Return T of an action, as CSR."""
    end = len(grid)
    aims = grid.beside[:, [heading, heading - 1, (heading + 1) % 4]]
    aims = np.r_[np.where(over[:, None], end, aims), np.full((1, 3), end)]
    chances = np.tile([1 - slip, slip / 2, slip / 2], len(aims))
    matrix = csr((chances, aims.ravel(), np.arange(0, aims.size + 1, 3)), (end + 1, end + 1))
    matrix.sum_duplicates()
    return matrix


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
