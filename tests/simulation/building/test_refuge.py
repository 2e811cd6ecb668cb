"""Refuges: off the ways of others, near, and not through them."""

from __future__ import annotations

import math

import numpy as np

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
