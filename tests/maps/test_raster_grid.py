"""Occupancy grids, against plain distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import MapError
from mdm.maps import Frame, Grid


@given(st.integers(1, 7), st.integers(1, 7), st.randoms(use_true_random=False))
def test_clearance_is_the_distance_to_the_nearest_cell_that_is_not_free(rows, columns, random):
    free = np.array([[random.random() < 0.8 for _ in range(columns)] for _ in range(rows)])
    grid = Grid(Frame(rows, columns, 0.5), free, np.zeros_like(free))
    clearance, edges = grid.clearance(), grid.clearance_to_edges()
    blocked = [
        (r, c)
        for r in range(-1, rows + 1)
        for c in range(-1, columns + 1)
        if not (0 <= r < rows and 0 <= c < columns and free[r, c])
    ]
    for r in range(rows):
        for c in range(columns):
            assert clearance[r, c] == pytest.approx(0.5 * min(math.dist((r, c), other) for other in blocked))
            away = [[max(abs(one - here) - 0.5, 0.0) for one, here in zip(at, (r, c), strict=True)] for at in blocked]
            nearest = 0.0 if not free[r, c] else 0.5 * min(math.hypot(*each) for each in away)
            assert edges[r, c] == pytest.approx(nearest)


def test_rasters_that_do_not_fit_are_refused():
    free = np.ones((2, 3), dtype=bool)
    with refused(MapError):
        Grid(Frame(3, 2, 1.0), free, ~free)
    with refused(MapError):
        Grid(Frame(2, 3, 1.0), free, free)


def test_a_robot_fits_where_the_clearance_is_as_large():
    grid = Grid(Frame(7, 7, 0.05), np.ones((7, 7), dtype=bool), np.zeros((7, 7), dtype=bool))
    assert grid.fits(0.2).sum() == 1
    assert grid.fits(0.15).sum() == 9  # three cells of 0.05 m are a little more
    assert grid.fits(0.21).sum() == 0
    assert grid.fits(0.0).all()
