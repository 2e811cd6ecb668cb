"""Grids drawn as text: which cells there are, and which lie beside each other."""

from __future__ import annotations

import textwrap

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError

__all__ = ["DIRECTIONS", "Grid"]

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
