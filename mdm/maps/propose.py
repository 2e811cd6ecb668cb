"""Proposals: rooms, goals and ways from an occupancy grid alone, to be corrected by hand.

The free cells are divided at narrow passages, as for drafts (see `mdm.maps.draft`), and joined again: first across what
is no door, since it is nearly as wide as the narrower of the two regions; then regions that are too small for rooms,
through their widest passages. Of a region without doors, such as a hall, nothing divides the parts: it is one room.

A goal is as near to the middle of its room as a robot fits well. Ways lead through passages that are wide enough.
What a robot cannot reach from the largest part of the floor is left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from mdm.errors import MapError
from mdm.maps.draft import draft, rooms
from mdm.maps.graph import Edge, Graph, Node, Pose
from mdm.maps.labels import Labels
from mdm.maps.lookup import border_distance
from mdm.maps.metres import check_metres
from mdm.maps.passages import leads, passages
from mdm.maps.paths import drivable, needed_clearance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mdm.maps.grid import Grid

    Mask = NDArray[np.bool_]

__all__ = ["propose"]

_DOOR, _ALIKE = 0.75, 0.4
"""The share of the width of the narrower of two regions from which a passage is no door, if they are so alike."""
_LEAST = 4.0
"""Square metres of a room."""
_AMPLY = 1.2
"""So many margins are enough."""
_ROUNDS = 2
_SLACK = 1e-9


def propose(grid: Grid, *, radius: float = 0.25, margin: float = 0.3, least: float = _LEAST) -> Graph:
    """Propose a graph of places for a grid: rooms, a goal in each, and a way in either direction through each door.

    Rooms are called ``Room1`` and so on, from the upper left to the lower right.

    Args:
        grid: The floor.
        radius: Of the robot, in metres.
        margin: How deep inside a place a robot must be that comes into it, in metres.
        least: The square metres of a room, of what a robot can reach; smaller ones belong to their neighbours.

    Raises:
        MapError: If the robot fits nowhere, or a length is none.
    """
    check_metres(radius, "the radius")
    check_metres(margin, "the margin")
    check_metres(least, "the least area")
    reached = _reached(grid, radius)
    regions = rooms(grid, reached, door=_DOOR, alike=_ALIKE, least=least)
    numbers = np.unique(regions[reached])
    raster = np.searchsorted(numbers, regions).astype(np.uint16) + 1
    raster[~np.isin(regions, numbers)] = 0
    labels = Labels(grid.frame, raster, tuple(f"Room{index}" for index in range(1, len(numbers) + 1)))
    for _ in range(_ROUNDS):  # a draft from goals has other borders than the regions, and goals lie off borders
        nodes = _goals(labels, grid, reached, radius, margin)
        labels = draft(grid, Graph(nodes, ()))
    return Graph(nodes, _ways(labels, grid, radius))


def _reached(grid: Grid, radius: float) -> Mask:
    """Return the cells where a robot fits, of the largest part of the floor that it can drive over."""
    parts, count = ndimage.label(drivable(grid, radius))
    if not count:
        raise MapError(f"a robot with a radius of {radius:g} m fits nowhere on this map")
    largest = 1 + int(np.bincount(parts.ravel())[1:].argmax())
    reached: Mask = parts == largest
    return reached


def _goals(labels: Labels, grid: Grid, reached: Mask, radius: float, margin: float) -> tuple[Node, ...]:
    """Return places with goals: in each the cell nearest to the middle, of those that are far enough from all else.

    Far enough is a robot's radius and the margin from walls, and the margin from other places; if none is, the furthest
    counts.
    """
    room = grid.clearance() - needed_clearance(grid, radius)
    far = np.minimum(room / margin, border_distance(labels) / margin) if margin else reached
    far = np.minimum(far, _AMPLY)
    cells = []
    for name in labels.names:
        own = labels.cells(name) & reached
        best = np.argwhere(own & (far >= far[own].max() - _SLACK))
        away = np.hypot(*(best - np.argwhere(own).mean(axis=0)).T)
        row, column = best[int(away.argmin())].tolist()
        cells.append((row, column))
    return tuple(
        Node(f"Room{index}", Pose(*(round(metres, 3) for metres in grid.frame.centre(*cell))))
        for index, cell in enumerate(sorted(cells), 1)
    )


def _ways(labels: Labels, grid: Grid, radius: float) -> tuple[Edge, ...]:
    """Return a way in either direction between places that touch by a passage that is wide enough."""
    driven = drivable(grid, radius)
    pairs = [passage.places for passage in passages(labels, grid) if leads(passage, driven)]
    index = labels.names.index
    both = sorted(
        {pair for one, other in pairs for pair in ((one, other), (other, one))},
        key=lambda pair: (index(pair[0]), index(pair[1])),
    )
    return tuple(Edge(source, target, f"to {target}") for source, target in both)
