"""Proposals, against floors that were drawn room by room."""

from __future__ import annotations

import math

import numpy as np
import pytest
from maps.floors import FURNITURE, flat, offices
from sentences import refused

from mdm.errors import MapError
from mdm.maps import Frame, Grid, Map, check, draft, propose


@pytest.mark.parametrize("drawn", [offices, flat])
@pytest.mark.parametrize("furnished", [False, True])
def test_a_room_a_goal_and_a_way_for_each_that_was_drawn(drawn, furnished):
    """The floor has a door between each two rooms that touch; nothing is known of it but which cells are free."""
    floor = drawn(furniture=FURNITURE[drawn], specks=40) if furnished else drawn()
    graph = propose(floor.grid)
    room = {node.name: floor.labels.name(node.goal.x, node.goal.y) for node in graph.nodes}
    assert sorted(room.values()) == sorted(floor.rooms)
    ways = {(room[edge.source], room[edge.target]) for edge in graph.edges}
    assert ways == {way for pair in floor.doors for way in (pair, pair[::-1])}
    assert check(Map(draft(floor.grid, graph), graph, floor.grid)) == ()


def test_a_corridor_that_opens_into_a_hall_is_no_part_of_it():
    free = np.zeros((120, 200), dtype=bool)
    free[10:110, 5:95] = True
    free[50:64, 95:195] = True
    frame = Frame(120, 200, 0.1)
    graph = propose(Grid(frame, free, ~free))
    assert sorted(frame.cell(node.goal.x, node.goal.y)[1] > 95 for node in graph.nodes) == [False, True]
    assert len(graph.edges) == 2


def test_what_no_robot_can_reach_is_left_out():
    free = np.zeros((60, 100), dtype=bool)
    free[5:55, 5:55] = free[5:55, 60:95] = True
    free[29:32, 55:60] = True  # a gap of 0.3 m
    graph = propose(Grid(Frame(60, 100, 0.1), free, ~free))
    (node,) = graph.nodes
    assert (node.goal.x, node.goal.y) == pytest.approx((3.0, 3.0), abs=0.1)
    assert graph.edges == ()
    assert len(propose(Grid(Frame(60, 100, 0.1), free, ~free), radius=0.1).nodes) == 2


@pytest.mark.parametrize(("least", "count"), [(2.5, 2), (3.5, 1)])
def test_a_room_that_is_smaller_than_the_least_belongs_to_its_neighbour(least, count):
    free = np.zeros((60, 110), dtype=bool)
    free[10:50, 5:50] = True
    free[20:42, 52:74] = True  # 2.2 m wide, of which a robot's middle reaches 1.7 m: 2.9 square metres
    free[28:36, 50:52] = True
    assert len(propose(Grid(Frame(60, 110, 0.1), free, ~free), least=least).nodes) == count


def test_a_turned_map_has_the_same_rooms():
    floor = flat()
    turned = Frame(*floor.frame.shape, floor.frame.resolution, 3.0, 1.0, math.pi / 2)
    some, other = propose(floor.grid), propose(Grid(turned, floor.grid.free, floor.grid.occupied))
    assert some.edges == other.edges
    for one, there in zip(some.nodes, other.nodes, strict=True):
        assert floor.frame.cell(one.goal.x, one.goal.y) == turned.cell(there.goal.x, there.goal.y)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": 30.0}, "a robot with a radius of 30 m fits nowhere on this map"),
        ({"radius": math.nan}, "the radius is a number of metres"),
        ({"margin": -1.0}, "the margin is a number of metres"),
        ({"least": math.inf}, "the least area is a number of"),
    ],
)
def test_what_cannot_be_is_refused(options, message):
    with pytest.raises(MapError, match=message):
        propose(flat().grid, **options)


def test_a_map_without_free_cells():
    nothing = np.zeros((9, 9), dtype=bool)
    with refused(MapError):
        propose(Grid(Frame(9, 9, 0.1), nothing, nothing))
