"""Paths, against a plain search."""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import MapError
from mdm.maps import Frame
from mdm.maps.paths import Paths, sees


def plain(free, starts):
    """Return metres to the nearest start by Dijkstra's search, cell by cell."""
    rows, columns = free.shape
    best, queue = dict.fromkeys(starts, 0.0), [(0.0, start) for start in starts]
    while queue:
        far, (row, column) = heapq.heappop(queue)
        if far > best[row, column]:
            continue
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                there = row + down, column + right
                if not (0 <= there[0] < rows and 0 <= there[1] < columns and free[there]):
                    continue
                if not (free[row, there[1]] and free[there[0], column]):
                    continue
                further = far + 0.5 * math.hypot(down, right)
                if further < best.get(there, math.inf) - 1e-12:
                    best[there] = further
                    heapq.heappush(queue, (further, there))
    return best


@given(st.integers(1, 8), st.integers(1, 8), st.integers(1, 3), st.randoms(use_true_random=False))
def test_distances_are_those_of_a_plain_search(rows, columns, count, random):
    free = np.array([[random.random() < 0.75 for _ in range(columns)] for _ in range(rows)])
    free[0, 0] = True
    cells = [tuple(map(int, cell)) for cell in np.argwhere(free)]
    starts = list(dict.fromkeys(random.choice(cells) for _ in range(count)))
    distances, nearest = Paths(Frame(rows, columns, 0.5), free).distances(starts)
    want = plain(free, starts)
    alone = [plain(free, [start]) for start in starts]
    for cell in np.ndindex(free.shape):
        assert distances[cell] == pytest.approx(want.get(cell, math.inf))
        if cell in want:
            assert alone[nearest[cell]][cell] == pytest.approx(want[cell])
        else:
            assert nearest[cell] == -1


@given(st.integers(1, 12), st.integers(1, 12), st.randoms(use_true_random=False))
def test_ways_run_straight_over_open_cells_from_end_to_end(rows, columns, random):
    free = np.array([[random.random() < 0.7 for _ in range(columns)] for _ in range(rows)])
    free[0, 0] = free[-1, -1] = True
    start, end = (0, 0), (rows - 1, columns - 1)
    way = Paths(Frame(rows, columns, 0.5), free).way(start, end)
    length = plain(free, [end]).get(start, math.inf)
    if not way:
        assert length == math.inf
        return
    assert (way[0], way[-1]) == (start, end)
    assert all(sees(free, one, other) for one, other in itertools.pairwise(way))
    assert 0.5 * sum(math.dist(one, other) for one, other in itertools.pairwise(way)) <= length + 1e-9


@given(st.integers(1, 12), st.integers(1, 12), st.randoms(use_true_random=False))
def test_lengths_are_those_on_the_whole_floor(rows, columns, random):
    free = np.array([[random.random() < 0.7 for _ in range(columns)] for _ in range(rows)])
    free[0, 0] = True
    cells = [tuple(map(int, cell)) for cell in np.argwhere(free)]
    target, *some = (random.choice(cells) for _ in range(4))
    paths = Paths(Frame(rows, columns, 0.5), free)
    distances, _ = paths.distances([target])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdm.maps.paths._LEAST", 1)  # so that windows are smaller than the floor
        assert [paths.length(cell, target) for cell in some] == pytest.approx([distances[cell] for cell in some])


def test_a_way_around_that_leaves_the_first_window_is_no_shorter_than_it_is():
    free = np.ones((300, 300), dtype=bool)
    free[:299, 150] = False  # a wall, around whose end alone one comes
    paths = Paths(Frame(300, 300, 0.1), free)
    distances, _ = paths.distances([(0, 149)])
    assert paths.length((0, 151), (0, 149)) == pytest.approx(distances[0, 151])
    free[299, 150] = False
    assert Paths(Frame(300, 300, 0.1), free).length((0, 151), (0, 149)) == math.inf


def test_points_outside_and_in_walls_are_told():
    free = np.array([[True, False]])
    paths = Paths(Frame(1, 2, 1.0), free)
    assert paths.cell(0.5, 0.5) == (0, 0)
    with refused(MapError):
        paths.cell(2.5, 0)
    with refused(MapError):
        paths.cell(1.5, 0.5)
    with refused(MapError):
        paths.distances([(0, 1)])


@given(st.integers(2, 9), st.integers(2, 9), st.randoms(use_true_random=False))
def test_a_route_runs_straight_over_open_cells_from_turn_to_turn(rows, columns, random):
    free = np.array([[random.random() < 0.75 for _ in range(columns)] for _ in range(rows)])
    free[0, 0] = True
    paths = Paths(Frame(rows, columns, 0.5), free)
    distances, _ = paths.distances([(0, 0)])
    for cell in map(tuple, np.argwhere(np.isfinite(distances)).tolist()):
        route = [cell, *paths.route(distances, cell)]
        assert route[-1] == (0, 0)
        for one, other in itertools.pairwise(route):
            neighbours = max(abs(one[0] - other[0]), abs(one[1] - other[1])) <= 1
            assert neighbours or sees(free, one, other)
        length = sum(0.5 * math.dist(one, other) for one, other in itertools.pairwise(route))
        assert length <= distances[cell] + 1e-9


def test_from_where_there_is_no_way_there_is_no_route():
    paths = Paths(Frame(1, 3, 1.0), np.array([[True, False, True]]))
    distances, _ = paths.distances([(0, 0)])
    with refused(MapError):
        paths.route(distances, (0, 2))
