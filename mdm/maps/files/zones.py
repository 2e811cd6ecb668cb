"""Zones: the areas of places that a graph declares itself, as a raster of labels."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import MapError, MapWarning
from mdm.maps.raster import Frame, Labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mdm.maps.graph import Graph, Node

__all__ = ["frame_of", "labels_of"]

_SIDE = 0.05
_MOST = 4_000_000
_EDGE = 0.5
"""Metres around the zones of a graph that has no map."""


def frame_of(graph: Graph, reach: float | None) -> Frame:
    """Return a frame that holds all zones, in cells of 0.05 m; of more where there would be over four million.

    Raises:
        MapError: If a place has no zone, and `reach` is None.
    """
    points = np.array([point for node in graph.nodes for point in _outline(node, reach)])
    low, high = points.min(axis=0) - _EDGE, points.max(axis=0) + _EDGE
    width, height = high - low
    side = max(_SIDE, math.sqrt(float(width * height) / _MOST))
    return Frame(math.ceil(height / side), math.ceil(width / side), side, float(low[0]), float(low[1]))


def labels_of(graph: Graph, frame: Frame, reach: float | None) -> Labels:
    """Return the labels of a graph's zones.

    A cell belongs to a place if its centre lies in the zone; where zones overlap, to that of the nearer goal, with one
    warning. Of a place without zone is what lies in no zone, up to `reach` metres from its goal, and nearer to it than
    to the goals of others without zone.

    Raises:
        MapError: If a place has no zone, and `reach` is None; or if a place has no cell.
    """
    raster = np.zeros(frame.shape, dtype=np.uint16)
    nearest = np.full(frame.shape, np.inf)
    overlaps: dict[tuple[str, str], int] = {}
    for label, node in sorted(enumerate(graph.nodes, 1), key=lambda item: item[1].zone is None):  # zones come first
        window, inside = _inside([frame.locate(*point) for point in _outline(node, reach)], frame)
        if not inside.size:
            continue
        place, distance = raster[window], _distances(frame, window, node)
        if node.zone is None:
            held = np.array([True, *(each.zone is None for each in graph.nodes)])[place]
            inside = held & (distance <= (reach or 0.0))  # a circle, not its outline
        else:
            for other, count in zip(*np.unique(place[inside & (place > 0)], return_counts=True), strict=True):
                overlaps[graph.nodes[other - 1].name, node.name] = int(count)
        taken = inside & (distance < nearest[window])
        place[taken] = label
        nearest[window][taken] = distance[taken]
    present = np.isin(np.arange(1, len(graph.nodes) + 1), raster)
    empty = [name for name, there in zip(graph.names, present, strict=True) if not there]
    if empty:
        raise MapError(
            f"no cell of the map belongs to {', '.join(empty)}: it lies outside the map, within others' zones, at "
            f"another's goal, or is smaller than a cell"
        )
    if overlaps:
        warnings.warn(MapWarning(_told(overlaps, frame)), stacklevel=2)
    return Labels(frame, raster, graph.names)


def _outline(node: Node, reach: float | None) -> Sequence[tuple[float, float]]:
    """Return the corners of a place's zone, or of the square around the circle that it has in place of one."""
    if node.zone is not None:
        return node.zone
    if reach is None:
        raise MapError(
            f"{node.name!r} has no zone: give an image with labels, or how far from its goal a place reaches"
        )
    x, y = node.goal.x, node.goal.y
    far = reach * math.sqrt(2)  # whichever way the map is turned
    return [(x - far, y - far), (x + far, y - far), (x + far, y + far), (x - far, y + far)]


def _inside(corners: list[tuple[float, float]], frame: Frame) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
    """Return the part of the raster that a polygon spans, and for its cells whether the centre is inside (even-odd)."""
    rows, columns = np.array(corners).T
    top, bottom = max(math.ceil(rows.min()), 0), min(math.floor(rows.max()) + 1, frame.rows)
    left, right = max(math.ceil(columns.min()), 0), min(math.floor(columns.max()) + 1, frame.columns)
    window = slice(top, max(bottom, top)), slice(left, max(right, left))
    down = np.arange(window[0].start, window[0].stop)[:, None]
    across = np.arange(window[1].start, window[1].stop)[None, :]
    inside = np.zeros((down.size, across.size), dtype=bool)
    for (row, column), (next_row, next_column) in zip(corners, corners[1:] + corners[:1], strict=True):
        if row != next_row:
            between = (down >= min(row, next_row)) & (down < max(row, next_row))  # half open: a corner counts once
            crossing = column + (down - row) * (next_column - column) / (next_row - row)
            inside ^= between & (across < crossing)
    return window, inside


def _distances(frame: Frame, window: tuple[slice, slice], node: Node) -> NDArray[np.float64]:
    """Return the distance of the cells of a window to the goal of a place, in metres."""
    row, column = frame.locate(node.goal.x, node.goal.y)
    down = np.arange(window[0].start, window[0].stop)[:, None] - row
    across = np.arange(window[1].start, window[1].stop)[None, :] - column
    distances: NDArray[np.float64] = np.hypot(down, across) * frame.resolution
    return distances


def _told(overlaps: dict[tuple[str, str], int], frame: Frame) -> str:
    area = frame.resolution**2
    pairs = [f"{a} and {b} ({count * area:.2g} m²)" for (a, b), count in overlaps.items()]
    more = f", and {len(pairs) - 5} more pairs" if len(pairs) > 5 else ""
    return f"zones overlap: {', '.join(pairs[:5])}{more}; what they share belongs to the nearer goal"
