"""Floors for the eye: rasters no larger than a screen, places and ways."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.map import Floors, Map
from mdm.snapshots.frame import RobotFrame
from mdm.snapshots.scene import FloorScene, PlaceScene, WayScene

if TYPE_CHECKING:
    from mdm.maps.graph import Graph, Pose
    from mdm.maps.places import Places
    from mdm.maps.raster import Frame, Grid, Labels
    from mdm.messages import PoseUpdate

__all__ = ["floors_of", "robot_at", "robot_frame"]

_SIDE = 400
"""Cells along the longer side, at most."""
_PLACES = 254
_OCCUPIED = 255


def floors_of(places: Places) -> tuple[FloorScene, ...]:
    """Return the floors on which a robot's places lie."""
    floor = places.floor
    if isinstance(floor, Floors):
        return tuple([_scene(name, each.labels, each.graph, each.grid) for name, each in floor.maps.items()])
    if isinstance(floor, Map):
        return (_scene("", floor.labels, floor.graph, floor.grid),)
    return (_scene("", floor, None, None),)


def _step(frame: Frame) -> int:
    """Return how many cells of a raster become one, along each side."""
    return max(1, math.ceil(max(frame.shape) / _SIDE))


def _scene(name: str, labels: Labels, graph: Graph | None, grid: Grid | None) -> FloorScene:
    frame = labels.frame
    step = _step(frame)
    raster = np.minimum(labels.raster, _PLACES).astype(np.uint8)
    raster = raster[step // 2 :: step, step // 2 :: step].copy()
    if grid is not None:
        walls = grid.occupied
        rows, columns = raster.shape
        padded = np.zeros((rows * step, columns * step), np.bool_)
        cut = walls[: rows * step, : columns * step]
        padded[: cut.shape[0], : cut.shape[1]] = cut
        raster[padded.reshape(rows, step, columns, step).any(axis=(1, 3))] = _OCCUPIED
    nodes = {} if graph is None else {node.name: node for node in graph.nodes}
    places = []
    for number, place in enumerate(labels.names, 1):
        if place in nodes:
            row, column = frame.locate(nodes[place].goal.x, nodes[place].goal.y)
        else:
            cells = np.argwhere(labels.raster == number)
            row, column = cells.mean(axis=0).tolist() if len(cells) else (0.0, 0.0)
        places.append(PlaceScene(place, round(row / step, 2), round(column / step, 2)))
    ways = () if graph is None else tuple([WayScene(edge.source, edge.target, edge.label) for edge in graph.edges])
    rows, columns = raster.shape
    return FloorScene(
        *(name, rows, columns, frame.resolution * step),
        *(raster.tobytes(), tuple(places), ways),
    )


def robot_frame(places: Places, pose: Pose | None, goal: str | None) -> RobotFrame | None:
    """Return where a robot is on its floor; None where that is not known."""
    return None if pose is None else robot_at(places, pose, goal, places.place)


def robot_at(places: Places, pose: Pose | PoseUpdate, goal: str | None, place: str | None = None) -> RobotFrame:
    """Return a robot of a pose on its floor, in the place that is given or that the pose lies in."""
    floor = places.floor
    if isinstance(floor, Floors):
        name = pose.floor if pose.floor in floor.maps else next(iter(floor.maps))
        labels = floor.maps[name].labels
    else:
        name, labels = "", floor.labels if isinstance(floor, Map) else floor
    row, column = labels.frame.locate(pose.x, pose.y)
    step = _step(labels.frame)
    within = place if place is not None else labels.name(pose.x, pose.y)
    turned = round(pose.yaw - labels.frame.yaw, 3)
    return RobotFrame(round(row / step, 2), round(column / step, 2), turned, name, within, goal)
