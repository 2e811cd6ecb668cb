"""Frames, against a plain turn of points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm.errors import MapError
from mdm.maps import Frame

FRAMES = st.builds(
    Frame,
    rows=st.integers(1, 40),
    columns=st.integers(1, 40),
    resolution=st.floats(0.01, 2),
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    yaw=st.floats(-7, 7),
)


@given(frame=FRAMES, data=st.data())
def test_the_centre_of_a_cell_lies_in_it(frame, data):
    row, column = data.draw(st.integers(0, frame.rows - 1)), data.draw(st.integers(0, frame.columns - 1))
    assert frame.cell(*frame.centre(row, column)) == (row, column)
    xs, ys = frame.centres()
    assert (xs[row, column], ys[row, column]) == pytest.approx(frame.centre(row, column), abs=1e-9)


@given(frame=FRAMES, x=st.floats(-100, 100), y=st.floats(-100, 100))
def test_a_point_lies_where_a_turn_back_by_complex_numbers_says(frame, x, y):
    turned = complex(x - frame.x, y - frame.y) / complex(math.cos(frame.yaw), math.sin(frame.yaw))
    along, up = turned.real / frame.resolution, turned.imag / frame.resolution
    near = min(abs(number - round(number)) for number in (along, up)) < 1e-6  # on a border rounding decides
    if not near:
        inside = 0 <= along < frame.columns and 0 <= up < frame.rows
        assert frame.cell(x, y) == ((frame.rows - 1 - math.floor(up), math.floor(along)) if inside else None)


@given(frame=FRAMES, row=st.floats(-60, 60), column=st.floats(-60, 60))
def test_points_are_located_in_and_out_of_the_raster(frame, row, column):
    assert frame.locate(*frame.centre(row, column)) == pytest.approx((row, column), abs=1e-6 / frame.resolution)


def test_row_0_is_the_uppermost_and_the_lowest_row_is_in_the_raster():
    frame = Frame(3, 2, 0.5, -1.0, -1.0)
    assert frame.cell(-1.0, -1.0) == (2, 0)
    assert frame.cell(-0.6, 0.4) == (0, 0)
    assert frame.cell(-0.6, 0.5) is None  # the upper border is another cell's
    assert frame.cell(0.0, 0.0) is None
    assert frame.cell(-1.1, 0.0) is None  # just left of it, which int() would take for column 0


def test_a_quarter_turn_is_exact():
    frame = Frame(2, 3, 1.0, 0.0, 0.0, math.pi / 2)
    assert frame.cell(-0.5, 2.5) == (1, 2)
    assert frame.cell(0.0, 0.0) == (1, 0)
    assert frame.cell(0.5, 0.5) is None


@pytest.mark.parametrize(("x", "y"), [(math.nan, 0), (0, math.nan), (math.inf, 0), (0, -math.inf)])
def test_a_point_that_is_not_finite_lies_nowhere(x, y):
    assert Frame(3, 3, 1.0).cell(x, y) is None


@pytest.mark.parametrize(
    "wrong", [{"rows": 0}, {"columns": 0}, {"resolution": 0.0}, {"resolution": math.nan}, {"yaw": math.inf}]
)
def test_a_frame_without_cells_is_refused(wrong):
    with pytest.raises(MapError):
        Frame(**({"rows": 1, "columns": 1, "resolution": 1.0} | wrong))


def test_frames_compare_by_what_they_say():
    assert Frame(3, 3, 1.0) == Frame(3, 3, 1.0)
    assert Frame(3, 3, 1.0) != Frame(3, 3, 1.0, yaw=np.pi)
