"""Walls, against the borders of single cells."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm.maps import Frame, Grid
from mdm.simulation.building.body import walls


@given(st.integers(1, 6), st.integers(1, 6), st.randoms(use_true_random=False))
def test_walls_are_the_borders_between_what_is_free_and_what_is_not(rows, columns, random):
    free = np.array([[random.random() < 0.6 for _ in range(columns)] for _ in range(rows)])
    grid = Grid(Frame(rows, columns, 1.0), free, ~free)

    def is_free(row, column):
        return 0 <= row < rows and 0 <= column < columns and free[row, column]

    borders = set()  # the middles of the sides of cells
    for row in range(-1, rows + 1):
        for column in range(-1, columns + 1):
            if is_free(row, column) != is_free(row + 1, column):
                borders.add((column + 0.5, float(rows - row - 1)))
            if is_free(row, column) != is_free(row, column + 1):
                borders.add((column + 1.0, rows - row - 0.5))
    found = []
    for (x, y), (to_x, to_y) in walls(grid):
        length = math.dist((x, y), (to_x, to_y))
        for step in range(round(length)):
            share = (step + 0.5) / length
            found.append((round(x + share * (to_x - x), 6), round(y + share * (to_y - y), 6)))
    assert len(found) == len(set(found))
    assert set(found) == borders


def test_walls_of_a_turned_map_are_turned():
    free = np.ones((1, 2), dtype=bool)
    found = walls(Grid(Frame(1, 2, 1.0, 5.0, 0.0, math.pi / 2), free, ~free))
    corners = {(round(x, 6), round(y, 6)) for ends in found for x, y in ends}
    assert corners == {(5.0, 0.0), (5.0, 2.0), (4.0, 0.0), (4.0, 2.0)}
    assert sum(math.dist(*ends) for ends in found) == pytest.approx(6.0)
