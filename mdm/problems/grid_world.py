"""Grid worlds: an agent that slips on its way to a goal."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models import MDP
from mdm.models.matrices import csr
from mdm.problems.grid import DIRECTIONS, Grid
from mdm.problems.parameters import checked

__all__ = ["grid_world"]

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
        step_reward: What an action outside goals and pits pays.
        goal_reward: What an action in a goal pays.
        pit_reward: What an action in a pit pays.
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
