"""Floors for the eye, against the maps that they are of."""

from __future__ import annotations

import numpy as np
import pytest

from mdm.actors import PredicateManager
from mdm.maps import Edge, Frame, Graph, Grid, Labels, Map, Node, Places, Pose
from mdm.snapshots.scenes import floors_of, robot_at


def a_floor(rows, columns, yaw=0.0):
    frame = Frame(rows, columns, 0.1, x=1.0, y=2.0, yaw=yaw)
    raster = np.zeros((rows, columns), np.uint16)
    raster[:, : columns // 2], raster[:, columns // 2 :] = 1, 2
    occupied = np.zeros((rows, columns), np.bool_)
    occupied[0] = True
    x, y = frame.centre(rows // 2, columns // 4)
    graph = Graph(
        (Node("Hall", Pose(x, y)), Node("Lab", Pose(*frame.centre(rows // 2, 3 * columns // 4)))),
        (Edge("Hall", "Lab", "Right"),),
    )
    return Map(Labels(frame, raster, ("Hall", "Lab")), graph, Grid(frame, ~occupied, occupied))


def places_of(floor):
    return Places(floor, PredicateManager(), margin=0.0)


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_small_rasters_are_as_they_are(yaw):
    floor = a_floor(20, 40, yaw)
    (scene,) = floors_of(places_of(floor))
    raster = np.frombuffer(scene.raster, np.uint8).reshape(scene.rows, scene.columns)
    expected = floor.labels.raster.astype(np.uint8)
    expected[0] = 255
    assert (raster == expected).all()
    assert [(place.name, place.row, place.column) for place in scene.places] == [("Hall", 10, 10), ("Lab", 10, 30)]
    assert [(way.source, way.target, way.label) for way in scene.ways] == [("Hall", "Lab", "Right")]


def test_large_rasters_keep_their_walls_and_where_things_lie():
    floor = a_floor(1001, 900)
    places = places_of(floor)
    (scene,) = floors_of(places)
    raster = np.frombuffer(scene.raster, np.uint8).reshape(scene.rows, scene.columns)
    assert max(raster.shape) <= 400
    assert (raster[0] == 255).all()  # a wall of one cell
    assert scene.metres == pytest.approx(0.3)
    robot = robot_at(places, floor.graph.node("Lab").goal, "Hall")
    assert (robot.place, robot.goal) == ("Lab", "Hall")
    assert raster[int(robot.row), int(robot.column)] == 2
    assert (robot.row, robot.column) == pytest.approx((500 / 3, 675 / 3), abs=0.01)
