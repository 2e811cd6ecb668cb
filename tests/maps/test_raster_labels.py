"""Labels, against plain distances and a drawing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import MapError
from mdm.maps import Frame, Labels


@given(st.integers(1, 6), st.integers(1, 6), st.integers(0, 3), st.randoms(use_true_random=False))
def test_depth_is_the_distance_to_the_nearest_cell_of_another_place(rows, columns, places, random):
    raster = np.array([[random.randint(0, places) for _ in range(columns)] for _ in range(rows)], dtype=np.uint16)
    labels = Labels(Frame(rows, columns, 0.25), raster, tuple("abc"[:places]))
    cells = [(r, c) for r in range(rows) for c in range(columns)]
    for cell in cells:
        others = [other for other in cells if raster[other] not in {0, raster[cell]}]
        want = min((0.25 * math.dist(cell, other) for other in others), default=math.inf) if raster[cell] else 0.0
        assert labels.depth[cell] == pytest.approx(want)


@given(st.lists(st.tuples(st.integers(0, 59), st.integers(0, 39)), min_size=1, max_size=5, unique=True))
def test_depth_is_right_however_far_apart_places_are(cells):
    raster = np.zeros((60, 40), dtype=np.uint16)
    for label, cell in enumerate(cells, 1):
        raster[cell] = label
    depth = Labels(Frame(60, 40, 1.0), raster, tuple("abcde"[: len(cells)])).depth
    for cell in cells:
        assert depth[cell] == pytest.approx(min((math.dist(cell, c) for c in cells if c != cell), default=math.inf))
    assert np.count_nonzero(depth) == len(cells)


def test_colours_become_places_and_others_are_counted():
    colours = np.array([[7, 7, 0], [9, 3, 0]], dtype=np.uint32)
    labels = Labels.from_colours(Frame(2, 3, 1.0), colours, {"kitchen": 9, "hall": 7})
    assert labels.names == ("kitchen", "hall")
    assert labels.raster.tolist() == [[2, 2, 0], [1, 0, 0]]
    assert labels.unnamed == {0: 2, 3: 1}
    assert labels.name(0.5, 0.5) == "kitchen"
    assert labels.name(1.5, 1.5) == "hall"
    assert labels.name(2.5, 1.5) is None
    assert labels.name(5, 5) is None
    assert labels.cells("hall").tolist() == [[True, True, False], [False, False, False]]
    with refused(MapError):
        labels.cells("hal")


def test_strays_are_fewer_than_any_place_and_than_a_hundredth():
    unnamed = {5: 300, 6: 99, 7: 100, 8: 1}
    raster = np.zeros((100, 100), dtype=np.uint16)
    assert Labels(Frame(100, 100, 1.0), raster, ("a",), unnamed).strays == {6: 99, 8: 1}
    raster[0, :99] = 1
    assert Labels(Frame(100, 100, 1.0), raster, ("a",), unnamed).strays == {8: 1}


def test_what_is_ambiguous_is_refused():
    frame, raster = Frame(1, 2, 1.0), np.array([[1, 2]], dtype=np.uint16)
    with refused(MapError):
        Labels.from_colours(frame, raster, {"a": 255, "b": 255})
    with refused(MapError):
        Labels(frame, raster, ("a", "a"))
    with refused(MapError):
        Labels(frame, raster, ("a",))
    with refused(MapError):
        Labels(Frame(2, 1, 1.0), raster, ("a", "b"))


def test_black_is_no_stray():
    """Drafts have it where there is no place: on a large floor that is little."""
    raster = np.ones((100, 100), dtype=np.uint16)
    raster[0, :50] = 0
    assert Labels(Frame(100, 100, 1.0), raster, ("a",), {0: 30, 0xFF << 24: 15, 8: 5}).strays == {8: 5}
