"""The look-up: the same as the labels and their depth say, point by point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm.maps import Frame, Labels
from mdm.maps.raster import lookup

COORDINATE = st.floats(-8, 8) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -0.0, 2.0, 1e300])


def labels(draw_seed, yaw, count=3):
    random = np.random.default_rng(draw_seed)
    raster = random.integers(count + 1, size=(7, 9)).astype(np.uint16)
    return Labels(Frame(7, 9, 0.5, -1.25, 0.75, yaw), raster, tuple(f"room{n}" for n in range(count)))


@given(st.integers(0, 20), st.sampled_from([0.0, 0.3, math.pi / 2, math.pi, -2.5]), COORDINATE, COORDINATE)
def test_a_point_is_where_its_cell_is(seed, yaw, x, y):
    drawn = labels(seed, yaw)
    code = lookup(drawn, 0.6)(x, y)
    assert (drawn.names[(code >> 1) - 1] if code else None) == drawn.name(x, y)
    cell = drawn.frame.cell(x, y)
    assert code & 1 == (cell is not None and drawn.raster[cell] > 0 and drawn.depth[cell] - 0.25 >= 0.6)


@pytest.mark.parametrize("count", [127, 128, 300])
def test_there_may_be_many_places(count):
    frame = Frame(30, 40, 1.0)
    raster = (np.arange(1200) % count + 1).reshape(30, 40).astype(np.uint16)
    look_up = lookup(Labels(frame, raster, tuple(map(str, range(count)))), 0.0)
    assert look_up(39.5, 0.5) == 2 * int(raster[-1, -1]) + 1
    assert look_up(0.5, 29.5) == 2 * 1 + 1


def test_a_depth_of_the_margin_counts_whatever_rounding_does():
    raster = np.repeat([[1, 2]], 10, axis=1).astype(np.uint16)
    look_up = lookup(Labels(Frame(1, 20, 0.1), raster, ("a", "b")), 0.25)
    assert [look_up(0.1 * column + 0.05, 0.05) for column in range(6, 14)] == [3, 3, 2, 2, 4, 4, 5, 5]
