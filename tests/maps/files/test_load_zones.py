"""Zones as rasters, cell by cell against a plain test of points."""

from __future__ import annotations

import heapq
import itertools
import math
import warnings

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from sentences import refused

from mdm.errors import MapError, MapWarning
from mdm.maps import Frame, Graph, Grid, Node, Pose, load_map
from mdm.maps.files.load import frame_of, labels_of

COORDINATES = st.floats(-3, 8)
CORNERS = st.lists(st.tuples(COORDINATES, COORDINATES), min_size=3, max_size=7)


def square(x, y, half):
    return ((x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half))


def graph(*nodes):
    return Graph(tuple(Node(name, Pose(*goal), zone) for name, goal, zone in nodes), ())


def inside(point, corners):
    """Whether a ray to the right of a point meets an odd number of sides."""
    x, y = point
    odd = False
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            odd = not odd
    return odd


@given(CORNERS, st.floats(-4, 4))
def test_a_cell_belongs_to_the_zone_that_its_centre_lies_in(corners, yaw):
    frame = Frame(9, 11, 0.7, -0.3, -0.4, yaw)
    own = np.array([[inside(frame.centre(row, column), corners) for column in range(11)] for row in range(9)])
    near = any(
        _distance(frame.centre(row, column), a, b) < 1e-6
        for row in range(9)
        for column in range(11)
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    )
    assume(own.any() and not near)
    labels = labels_of(graph(("a", (0, 0), tuple(corners))), frame, None)
    assert np.array_equal(labels.cells("a"), own)


def _distance(point, a, b):
    (x, y), (ax, ay), (bx, by) = point, a, b
    length = (bx - ax) ** 2 + (by - ay) ** 2
    t = 0 if length == 0 else min(max(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length, 0), 1)
    return math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay))


def test_neighbours_share_no_cell_and_leave_none_out():
    """With a border through the centres of cells."""
    frame = Frame(10, 10, 1.0)
    some = graph(
        ("a", (2, 5), ((0, 0), (4.5, 0), (4.5, 10), (0, 10))), ("b", (7, 5), ((4.5, 0), (10, 0), (10, 10), (4.5, 10)))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        labels = labels_of(some, frame, None)
    assert (labels.raster > 0).all()


def test_what_zones_share_belongs_to_the_nearer_goal_and_is_told():
    some = graph(("a", (2.5, 2.5), square(2.5, 2.5, 2.5)), ("b", (6.5, 2.5), square(6.5, 2.5, 2.5)))
    with pytest.warns(MapWarning, match=r"zones overlap: a and b \(5 m²\); what they share belongs to the nearer goal"):
        labels = labels_of(some, Frame(5, 10, 1.0), None)
    assert labels.raster[0].tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 2, 0]
    swapped = graph(("b", (6.5, 2.5), square(6.5, 2.5, 2.5)), ("a", (2.5, 2.5), square(2.5, 2.5, 2.5)))
    with pytest.warns(MapWarning):
        assert labels_of(swapped, Frame(5, 10, 1.0), None).raster[0, 5] == 1


def test_a_place_without_zone_reaches_around_its_goal():
    frame = Frame(10, 20, 0.5)
    some = graph(("a", (2.25, 2.25), None), ("b", (4.25, 2.25), None), ("c", (3.25, 3.25), square(3.25, 3.25, 0.6)))
    labels = labels_of(some, frame, 1.4)
    for row in range(10):
        for column in range(20):
            x, y = frame.centre(row, column)
            a, b = math.hypot(x - 2.25, y - 2.25), math.hypot(x - 4.25, y - 2.25)
            if inside((x, y), square(3.25, 3.25, 0.6)):
                want = "c"
            else:
                want = None if min(a, b) > 1.4 else "a" if a <= b else "b"
            assert labels.name(x, y) == want, (x, y)
    with refused(MapError):
        labels_of(some, frame, None)


def test_a_place_without_zone_reaches_over_free_cells_alone():
    """A wall with one door: what is behind it is as far as the way through the door, by an own search over cells."""
    frame = Frame(20, 30, 0.25)
    free = np.ones(frame.shape, dtype=bool)
    free[:, 15] = False
    free[:, 15][17:19] = True
    some = graph(("a", (3.0, 3.0), None), ("b", (6.5, 3.0), None))
    reach = 3.0
    labels = labels_of(some, frame, reach, Grid(frame, free, ~free))
    far = {
        name: walked(free, frame.cell(node.goal.x, node.goal.y), 0.25)
        for name, node in zip("ab", some.nodes, strict=True)
    }
    straight = labels_of(some, frame, reach)
    for row, column in np.ndindex(frame.shape):
        a, b = far["a"][row, column], far["b"][row, column]
        near = min(a, b)
        want = 0 if near > reach + 1e-9 or not free[row, column] else 1 if a <= b else 2
        assert labels.raster[row, column] == want, (row, column)
    assert labels.raster[8, 16] == 2
    assert straight.raster[8, 16] == 1  # 1.5 m from a as the crow flies, and 2.25 m from b


def walked(free, start, side):
    """Return the metres from a cell over free ones, to the eight neighbours, diagonally only past two free cells."""
    far = np.full(free.shape, np.inf)
    far[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        done, (row, column) = heapq.heappop(queue)
        for down, right in itertools.product((-1, 0, 1), repeat=2):
            at = row + down, column + right
            inside = 0 <= at[0] < free.shape[0] and 0 <= at[1] < free.shape[1]
            if inside and free[at] and free[row, at[1]] and free[at[0], column]:
                there = done + math.hypot(down, right) * side
                if there < far[at] - 1e-9:
                    far[at] = there
                    heapq.heappush(queue, (there, at))
    return far


@pytest.mark.foreign("small inputs after public reports")
@pytest.mark.filterwarnings("ignore:.*not carried over")
def test_a_room_of_a_reported_map_is_its_own(corpus):
    files = corpus / "reported"
    floor = load_map(files / "s219.yaml", grid=files / "wall.yaml", reach=5.0)
    assert floor.labels.name(4.5, 0.8) == "W6"


def test_a_place_without_a_cell_is_refused():
    frame = Frame(4, 4, 1.0)
    for zone in (square(50, 50, 1), square(1, 1, 0.1)):
        with refused(MapError):
            labels_of(graph(("a", (1, 1), zone)), frame, None)
    with refused(MapError):
        labels_of(graph(("a", (1, 1), square(2, 2, 2)), ("b", (50, 50), None)), frame, 1.0)


def test_a_graph_makes_its_own_frame():
    some = graph(("a", (0, 0), square(0, 0, 1)), ("b", (3, 0), None))
    frame = frame_of(some, 0.5)
    labels = labels_of(some, frame, 0.5)
    assert frame.resolution == 0.05
    assert labels.cells("a").sum() == pytest.approx(4 / 0.05**2, rel=0.01)
    assert labels.cells("b").sum() == pytest.approx(math.pi * 0.25 / 0.05**2, rel=0.02)
    assert (labels.raster[0] == 0).all()
    assert (labels.raster[:, -1] == 0).all()
    wide = frame_of(graph(("a", (0, 0), square(0, 0, 1)), ("b", (1000, 1000), square(1000, 1000, 3))), None)
    assert wide.rows * wide.columns <= 4_010_000
