from __future__ import annotations

import pytest
from sentences import refused

from mdm import ModelError
from mdm.problems.grids import Grid


def test_cells_and_what_lies_beside_them():
    grid = Grid("""
        ab
        #c
    """)
    assert grid.marks == ("a", "b", "c")
    assert grid.places == ((0, 0), (0, 1), (1, 1))
    assert grid.beside.tolist() == [[0, 1, 0, 0], [1, 1, 2, 0], [1, 2, 2, 2]]
    assert grid.walls.tolist() == [[True, False, True, True], [True, True, False, False], [False, True, True, True]]
    assert grid.names == ["row0-column0", "row0-column1", "row1-column1"]
    assert grid.marked("bc").tolist() == [False, True, True]


def test_rows_on_one_line():
    assert Grid("ab/#c").places == Grid("ab\n c").places


@pytest.mark.parametrize("text", ["", "###", " / "])
def test_no_cell(text):
    with refused(ModelError):
        Grid(text)
