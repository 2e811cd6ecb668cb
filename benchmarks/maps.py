"""From one goal in each room to a draft of the rooms: mdm's two stages against one watershed and the nearest goal."""

from __future__ import annotations

import heapq
import itertools
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import arguments, report, table

from mdm.maps import Frame, Graph, Grid, Labels, Node, Pose, draft, passages
from mdm.maps.paths import Paths

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Raster = NDArray[np.uint16]

SIDE, WIDE, HIGH = 0.05, 440, 360
NAMES = tuple(f"room{number}" for number in range(6))
DOORS = {(0, 1): (90, 146), (1, 2): (60, 293), (1, 4): (180, 220), (3, 4): (300, 146), (4, 5): (250, 293)}
"""The row and the column of the middle of each door, by the rooms that it joins."""


def floor() -> tuple[Grid, Raster]:
    """Six rooms of 7 by 9 m in two rows, doors of 1 m, furniture and specks; and which room each cell belongs to."""
    rows, columns = np.indices((HIGH, WIDE))
    truth = (rows // 180 * 3 + columns // 147 + 1).astype(np.uint16)
    free = (rows % 180 > 2) & (columns % 147 > 2) & (rows < HIGH - 2) & (columns < WIDE - 2)
    for (one, other), (row, column) in DOORS.items():
        along, across = (10, 4) if other == one + 1 else (4, 10)
        free[row - along : row + along, column - across : column + across] = True
    random = np.random.default_rng(1)
    for row, column in random.integers((20, 20), (HIGH - 40, WIDE - 40), size=(12, 2)):
        if not any(abs(row - r) + abs(column - c) < 60 for r, c in DOORS.values()):
            free[row : row + 16, column : column + 24] = False
    for row, column in random.integers((4, 4), (HIGH - 8, WIDE - 8), size=(60, 2)):
        free[row : row + 3, column : column + 2] = False
    return Grid(Frame(HIGH, WIDE, SIDE), free, ~free), truth


def graph(grid: Grid, truth: Raster, random: np.random.Generator) -> Graph:
    """A goal somewhere in each room, 0.3 m from walls."""
    clear, nodes = grid.clearance() > 0.3, []
    for label, name in enumerate(NAMES, 1):
        cells = np.argwhere((truth == label) & clear)
        nodes.append(Node(name, Pose(*grid.frame.centre(*cells[random.integers(len(cells))]))))
    return Graph(tuple(nodes), ())


def by_path(grid: Grid, places: Graph) -> Labels:
    """Give each cell to the goal that is nearest by path."""
    paths = Paths(grid.frame, grid.free)
    seeds = [paths.cell(node.goal.x, node.goal.y) for node in places.nodes]
    _, nearest = paths.distances(seeds)
    return Labels(grid.frame, np.where(grid.free, nearest + 1, 0).astype(np.uint16), places.names)


def watershed(grid: Grid, places: Graph) -> Labels:
    """Give each cell to the goal from which it is flooded first: one watershed of clearance, the widest cells first."""
    clearance, raster = grid.clearance(), np.zeros(grid.frame.shape, dtype=np.uint16)
    order = itertools.count()
    front: list[tuple[float, int, int, int]] = []
    for label, node in enumerate(places.nodes, 1):
        cell = grid.frame.cell(node.goal.x, node.goal.y)
        assert cell is not None
        raster[cell] = label
        front.append((-np.inf, next(order), *cell))
    depth, free, rows, columns = (-clearance).tolist(), grid.free.tolist(), *grid.frame.shape
    found: list[list[int]] = raster.tolist()
    while front:
        level, _, row, column = heapq.heappop(front)
        for down, right in ((-1, 0), (0, -1), (0, 1), (1, 0)):
            there, beside = row + down, column + right
            if 0 <= there < rows and 0 <= beside < columns and free[there][beside] and not found[there][beside]:
                found[there][beside] = found[row][column]
                heapq.heappush(front, (max(level, depth[there][beside]), next(order), there, beside))
    return Labels(grid.frame, np.array(found, dtype=np.uint16), places.names)


def straight(grid: Grid, places: Graph) -> Labels:
    """Give each cell to the goal that is nearest as the crow flies."""
    x, y = grid.frame.centres()
    distances = [np.hypot(x - node.goal.x, y - node.goal.y) for node in places.nodes]
    return Labels(grid.frame, np.where(grid.free, np.argmin(distances, axis=0) + 1, 0).astype(np.uint16), places.names)


def drafts(quick: bool) -> list[dict[str, Any]]:
    """Draft the rooms of one floor from random goals in each way, and compare with what was drawn."""
    grid, truth = floor()
    wanted = {frozenset((NAMES[one], NAMES[other])) for one, other in DOORS}
    ways: dict[str, Callable[[Grid, Graph], Labels]] = {
        "mdm, two stages": draft,
        "one watershed": watershed,
        "nearest goal by path": by_path,
        "nearest goal, straight": straight,
    }
    rows = []
    for name, way in ways.items():
        random = np.random.default_rng(2)
        seconds, cells, right = [], [], 0
        for _ in range(2 if quick else 20):
            places = graph(grid, truth, random)
            began = time.perf_counter()
            labels = way(grid, places)
            seconds.append(time.perf_counter() - began)
            cells.append(float(np.mean(labels.raster[grid.free] == truth[grid.free])))
            right += {frozenset(passage.places) for passage in passages(labels, grid)} == wanted
        rows.append(
            {
                "way": name,
                "median_s": float(np.median(seconds)),
                "max_s": max(seconds),
                "cells right": float(np.mean(cells)),
                "least": min(cells),
                "neighbours right": f"{right} of {len(seconds)}",
            }
        )
    return rows


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    results = {"drafts": drafts(given.quick)}
    table(f"Drafts of six rooms from random goals, {WIDE} x {HIGH} cells", results["drafts"])
    report("maps", results, given.output)


if __name__ == "__main__":
    main()
