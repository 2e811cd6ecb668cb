"""Scenes for the eye: ensembles with their factors; floors, no larger than a screen, with places and ways."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.map import Floors, Map
from mdm.snapshots.beliefs import grid_factors
from mdm.snapshots.frame import EnsembleScene, FactorScene, FloorScene, PlaceScene, RobotFrame, WayScene

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.actors import Ensemble
    from mdm.maps.graph import Graph, Pose
    from mdm.maps.places import Places
    from mdm.maps.raster import Frame, Grid, Labels
    from mdm.messages import PoseUpdate
    from mdm.models import Space

_LISTED = 64
"""Actions, and symbols of a factor, that are listed."""

_SIDE = 400
"""Cells along the longer side, at most."""
_PLACES = 254
_OCCUPIED = 255


def factors_of(space: Space | None, ensemble: Ensemble | None = None) -> tuple[FactorScene, ...]:
    """Return the factors of a space of states as a scene has them, and the predicates of an ensemble that tell them."""
    wired = () if ensemble is None or ensemble.state is None else ensemble.state.factors
    told_by = {each.name: tuple(each.predicates) for each in wired}
    if space is None:  # of a policy without a model: the factors as they are wired
        return tuple([FactorScene(name, (), names if len(names) <= _LISTED else ()) for name, names in told_by.items()])
    return tuple(
        [
            FactorScene(each.name, tuple(each.names), told_by.get(each.name, ()))
            if len(each) <= _LISTED
            else FactorScene(each.name, ())
            for each in space.factors
        ]
    )


def ensembles_of(
    ensembles: Mapping[str, Ensemble | None],
    spaces: Mapping[str, Space | None],
    actions: Mapping[str, Sequence[str]],
) -> tuple[EnsembleScene, ...]:
    """Return the scenes of ensembles, by their paths, each behind the one above it.

    Args:
        ensembles: By their paths; None where only a record shows it.
        spaces: The states of each.
        actions: The names of the actions of those of which a record alone tells.
    """
    places = {path: place for place, path in enumerate(ensembles)}
    found = []
    for path, ensemble in ensembles.items():
        above = path.rpartition("/")[0]
        while above and above not in places:
            above = above.rpartition("/")[0]
        outer, space = ensembles.get(above), spaces[path]
        states = ensemble.controller.symbols.num_states if ensemble is not None else space and len(space)
        pairs = [] if outer is None else [*zip(outer.action.names, outer.action.bindings, strict=True)]
        bound = [name for name, binding in pairs if ensemble is not None and binding.ensemble is ensemble]
        found.append(
            EnsembleScene(
                path=path,
                parent=places.get(above, -1),
                bound=bound[0] if bound else "",
                summary="" if ensemble is None else ensemble.summary(),
                actions=tuple(actions.get(path, ()) if ensemble is None else ensemble.action.names)[:_LISTED],
                states=states or 0,
                factors=factors_of(space, ensemble),
                grid=grid_factors(space) is not None,
            )
        )
    return tuple(found)


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
    return FloorScene(name, rows, columns, frame.resolution * step, raster.tobytes(), tuple(places), ways)


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
