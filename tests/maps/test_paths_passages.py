"""Passages, by a floor whose doors are known."""

from __future__ import annotations

import numpy as np
import pytest
from floor_file import free, rooms

from mdm.maps import Frame, Grid, Labels
from mdm.maps.paths import passages, undivided, widest

NAMES = ("hall", "office", "store")


def labels(raster):
    return Labels(
        Frame(*raster.shape, 0.1),
        np.select([raster == name for name in NAMES], [1, 2, 3]).astype(np.uint16),
        NAMES,
    )


def grid(open_cells):
    return Grid(Frame(*open_cells.shape, 0.1), open_cells, ~open_cells)


def test_the_doors_of_a_floor():
    found = passages(labels(rooms()), grid(free()))
    assert [passage.places for passage in found] == [("hall", "store"), ("hall", "office")]
    assert [passage.width for passage in found] == pytest.approx([0.5, 0.4], abs=0.11)  # to a cell
    store, office = found
    assert 28 <= store.middle[0] < 33
    assert store.middle[1] in {19, 20}
    assert set(map(tuple, office.cells.tolist())) == {(row, column) for row in (19, 20) for column in range(8, 12)}


def test_two_doors_are_two_passages_and_the_widest_comes_first():
    raster = rooms()
    raster[24:26, 19] = "store"
    found = passages(labels(raster), grid(raster != ""))
    between = [passage for passage in found if passage.places == ("hall", "store")]
    assert [passage.width for passage in between] == pytest.approx([0.5, 0.2], abs=0.11)
    assert widest(found)[frozenset({"store", "hall"})] is between[0]


def test_free_cells_without_a_label_count_for_the_place_that_reaches_them_first():
    raster = rooms()
    blank = raster.copy()
    blank[20, 8:12] = ""  # the doors, and strips along them
    blank[17:24, 1:19] = ""
    blank[28:33, 18:21] = ""
    found = passages(labels(blank), grid(raster != ""))
    assert {passage.places for passage in found} == {("hall", "office"), ("hall", "store")}


def test_walls_and_cells_without_a_way_in_join_nothing():
    raster = rooms()
    raster[20, 8:12] = ""
    raster[28:33, 19] = ""
    assert passages(labels(raster), grid(raster != "")) == ()
    painted = raster.copy()
    painted[:21, :20] = "office"  # labels that are painted over the walls
    painted[21:, :20] = "hall"
    painted[:, 20:] = "store"
    assert passages(labels(painted), grid(raster != "")) == ()


def test_corners_that_meet_are_no_passage():
    raster = np.array([["hall", ""], ["", "office"]])
    assert passages(labels(raster), grid(raster != "")) == ()


def row_of_places(count, wall):
    """Return labels and a grid: places of 2 m in a row, divided by walls with doors, or by nothing."""
    open_cells = np.ones((20, 20 * count), dtype=bool)
    open_cells[[0, -1], :] = open_cells[:, [0, -1]] = False
    raster = np.repeat(np.arange(1, count + 1, dtype=np.uint16), 20)[None].repeat(20, axis=0)
    if wall:
        open_cells[:, 19:-1:20] = open_cells[:, 20::20] = False
        open_cells[8:13, 1:-1] = True
    frame = Frame(*raster.shape, 0.1)
    return Labels(frame, raster, tuple(map(str, range(count)))), Grid(frame, open_cells, ~open_cells)


@pytest.mark.parametrize(("count", "wall", "told"), [(10, False, 10), (10, True, 0), (5, False, 0)])
def test_points_of_a_route_are_told_from_rooms(count, wall, told):
    """Places in one hall are no rooms; those with doors between them are; of a few none is told."""
    some, open_cells = row_of_places(count, wall)
    assert len(undivided(some, open_cells, passages(some, open_cells))) == told
