"""Refuges: off the ways of others, near, and not through them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mdm.maps import Frame
from mdm.maps.paths import Paths
from mdm.simulation.building.refuge import refuge


def drawn(*lines):
    """Return paths over the dots of a drawing, a metre each."""
    free = np.array([[sign != "#" for sign in line] for line in lines])
    return Paths(Frame(*free.shape, 1.0), free)


def test_a_robot_in_a_passage_goes_into_a_niche():
    paths = drawn(
        "#########",
        "#####.###",
        "#####.###",
        ".........",
        "#########",
    )
    way = refuge(paths, (3, 4), [((3, 2), [(3, 8)], 0.5)])
    assert way[-1] == (2, 5)


def test_a_robot_goes_to_the_end_of_a_passage_that_another_leaves_before():
    paths = drawn(
        "####.####",
        "####.####",
        ".........",
    )
    assert refuge(paths, (2, 5), [((2, 3), [(2, 4), (0, 4)], 0.5)])[-1] == (2, 5)  # it is off the way there
    assert refuge(paths, (2, 4), [((2, 3), [(2, 4), (0, 4)], 0.5)])[-1] == (2, 5)


def test_there_is_no_refuge_behind_another_robot():
    paths = drawn("..........")
    assert refuge(paths, (0, 7), [((0, 5), [(0, 9)], 0.6)]) is None
    assert refuge(paths, (0, 7), [((0, 5), [(0, 9)], 0.6), ((0, 9), [], 0.6)]) is None
    assert refuge(paths, (0, 3), [((0, 5), [(0, 2)], 0.6)])[-1] == (0, 0)


def test_a_refuge_is_off_all_ways():
    free = np.ones((60, 60), dtype=bool)
    paths = Paths(Frame(60, 60, 0.1), free)
    ways = [((30, 5), [(30, 55)], 0.5), ((5, 34), [(55, 34)], 0.5)]
    row, column = refuge(paths, (30, 30), ways)[-1]
    assert abs(row - 30) * 0.1 > 0.5
    assert abs(column - 34) * 0.1 > 0.5
    assert math.hypot(row - 30, column - 30) < 15


@pytest.mark.parametrize(("niche", "found"), [(7, True), (9, False)])
def test_a_refuge_is_looked_for_nearby(niche, found):
    lines = ["#" * 20, "#" * (15 - niche) + "." + "#" * (4 + niche), "." * 20]
    way = refuge(drawn(*lines), (2, 15), [((2, 19), [(2, 0)], 0.5)])
    assert (way is not None) is found


def test_a_refuge_is_not_beside_one_that_stands():
    """It may be about to drive on."""
    paths = drawn(
        "..........",
        "..........",
        "#.#.######",
    )
    passing = ((0, 9), [(0, 0)], 0.7)
    assert refuge(paths, (0, 6), [passing])[-1] == (2, 3)
    assert refuge(paths, (0, 6), [passing, ((2, 3), [], 1.5)])[-1] == (2, 1)
    assert refuge(paths, (0, 6), [passing, ((2, 3), [], 1.7)]) is None


def test_a_robot_that_touches_another_finds_its_way_out_of_there():
    paths = drawn(
        "##########",
        "###.######",
        "..........",
    )
    assert refuge(paths, (2, 5), [((2, 6), [(2, 0)], 1.5)]) is None
    paths = drawn(
        "###.######",
        "###.######",
        "..........",
    )
    assert refuge(paths, (2, 5), [((2, 6), [(2, 0)], 1.5)])[-1] == (0, 3)
