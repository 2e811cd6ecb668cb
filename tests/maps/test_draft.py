"""Drafts, against floors that were drawn room by room."""

from __future__ import annotations

import math

import numpy as np
import pytest
from maps.floors import FURNITURE, corridors, flat, offices, touching

from mdm.errors import MapError
from mdm.maps import Frame, Graph, Grid, Node, Pose
from mdm.maps.draft import draft, propose


@pytest.mark.parametrize("times", [6, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize("drawn", [offices, corridors, flat])
def test_rooms_are_found_from_any_points_in_them(drawn, times):
    random = np.random.default_rng(7)
    floors = [drawn(), drawn(furniture=FURNITURE[drawn], specks=40)]
    right = []
    for turn in range(times):
        floor = floors[turn % 2]
        labels = draft(floor.grid, floor.graph(floor.random_points(random)))
        assert touching(labels) == floor.neighbours()
        free = floor.labels.raster > 0
        right.append(np.mean(labels.raster[free] == floor.labels.raster[free]))
    assert np.mean(right) >= 0.97


def test_a_room_that_is_hardly_narrower_somewhere_is_not_divided_there():
    free = np.zeros((60, 110), dtype=bool)
    free[10:50, 5:105] = True
    free[10:12, 35] = free[48:50, 35] = False  # 3.6 m wide there, else 4 m
    goals = Node("here", Pose(2.55, 3.05)), Node("there", Pose(6.55, 3.05))
    labels = draft(Grid(Frame(60, 110, 0.1), free, ~free), Graph(goals, ()))
    assert np.count_nonzero(labels.raster[30] == 1) == pytest.approx(40, abs=1)  # half way, not at column 35


def test_what_is_not_free_or_cannot_be_reached_belongs_to_no_place():
    free = np.zeros((40, 60), dtype=bool)
    free[5:35, 5:25] = free[5:35, 40:55] = True
    frame = Frame(40, 60, 0.1)
    labels = draft(Grid(frame, free, ~free), Graph((Node("here", Pose(1.0, 2.0)),), ()))
    assert (labels.raster[:, :30] > 0).tolist() == free[:, :30].tolist()
    assert not labels.raster[:, 30:].any()


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (Pose(100, 0), "the goal of 'there': the point 100, 0 lies outside the map"),
        (Pose(0.05, 0.05), "the goal of 'there': the point 0.05, 0.05 lies in a wall, or where nothing is known"),
        (Pose(1.02, 1.02), "the goals of 'here' and 'there' are one cell"),
    ],
)
def test_a_goal_that_stands_for_no_room_is_refused(goal, message):
    free = np.zeros((20, 20), dtype=bool)
    free[2:18, 2:18] = True
    graph = Graph((Node("here", Pose(1.05, 1.05)), Node("there", goal)), ())
    with pytest.raises(MapError, match=message):
        draft(Grid(Frame(20, 20, 0.1, yaw=0.0), free, ~free), graph)


def test_a_turned_map_gives_the_same_rooms():
    floor = flat()
    straight, turned = floor.frame, Frame(*floor.frame.shape, floor.frame.resolution, 3.0, 1.0, math.pi / 2)
    nodes = []
    for node in floor.graph().nodes:
        row, column = straight.cell(node.goal.x, node.goal.y)
        nodes.append(Node(node.name, Pose(*turned.centre(row, column))))
    labels = draft(Grid(turned, floor.grid.free, floor.grid.occupied), Graph(tuple(nodes), ()))
    assert labels.raster.tolist() == draft(floor.grid, floor.graph()).raster.tolist()


@pytest.mark.parametrize(("gap", "rooms"), [(6.8, 1), (4.2, 1), (3.0, 2)])
def test_an_open_hall_is_not_divided_at_what_is_too_wide_for_a_door(gap, rooms):
    """Two halves of 10 m by 10 m, with an opening between them."""
    free = np.zeros((52, 102), dtype=bool)
    free[1:51, 1:101] = True
    closed = round((10.0 - gap) / 2 / 0.2)
    free[1 : 1 + closed, 50:52] = free[51 - closed : 51, 50:52] = False
    assert len(propose(Grid(Frame(52, 102, 0.2), free, ~free)).names) == rooms
