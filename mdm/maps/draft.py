"""Drafts from an occupancy grid, to be corrected by hand: its rooms, and where no graph is given, goals and ways.

Labels take two stages. First the free cells are divided at narrow passages: each cell belongs to the peak of clearance
that leads up from it (a watershed), and peaks that rise by less than `_RISE` above the saddle between them are one.
Then regions are joined through the widest passage first, but never two that both hold a goal. A region that holds
several has no passage between them, and where it is divided is a convention: cells in sight of a goal belong to the
nearest such goal, the rest to the cells next to them.

The first stage is a watershed of the distance to walls (S. Beucher and C. Lantuejoul, *Use of watersheds in contour
detection*, 1979) whose small dynamics are suppressed (M. Grimaud, *A new measure of contrast: the dynamics*, 1992); the
second is a minimum spanning forest rooted in the goals (F. Meyer, *Minimum spanning forests for morphological
segmentation*, 1994). It costs a few passes over the cells: .2 s for 160,000 of them.

Without goals, regions are joined across a passage that is no door: it is wide, or nearly as wide as the narrower of the
two; then those that are too small for rooms, through their widest passages. Of a region without doors, such as a hall,
nothing divides the parts: it is one room. A goal is as near to the middle of its room as a robot fits well. Ways lead
through passages that are wide enough. Cells that a robot cannot reach from the largest part of the floor are left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from mdm.checks import check_metres
from mdm.errors import MapError
from mdm.maps.graph import Edge, Graph, Node, Pose
from mdm.maps.paths import Paths, drivable, leads, needed_clearance, passages, seen_from
from mdm.maps.raster import Grid, Labels, border_distance
from mdm.progress import report_share

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mdm.models.matrices import Vector

    Mask = NDArray[np.bool_]
    Regions = NDArray[np.intp]

_RISE = 0.3
"""Metres that a peak of clearance rises above a passage, or is none."""
_SPECK = 0.15
"""Square metres of furniture and noise that divide no room."""
_DOOR, _ALIKE = 0.75, 0.4
"""The share of the width of the narrower of two regions from which a passage is no door, if they are so alike: a
corridor that opens into a hall is another room."""
_WIDE = 4.0
"""Metres from which a passage is no door, whatever it leads to."""
_LEAST = 4.0
"""Square metres of a room."""
_AMPLY = 1.2
"""So many margins are enough."""
_ROUNDS = 2
_WORK = "drafting the labels"
_CLEARANCE, _PEAKS, _JOINED = 0.3, 0.6, 0.75
"""The shares of a draft's time after which its stages are done, by measurement: what follows are the regions."""
_SLACK = 1e-9


def draft(grid: Grid, graph: Graph) -> Labels:
    """Divide the free cells of a grid into the places of a graph, as a draft to be corrected by hand.

    Args:
        grid: The floor.
        graph: The places; their goals say where they are.

    Raises:
        MapError: If a goal lies outside, in a wall, or in the same cell as another one.
    """
    report_share(_WORK, 0.0)
    open_cells = _without_specks(grid)
    paths = Paths(grid.frame, open_cells)
    seeds: list[tuple[int, int]] = []
    for node in graph.nodes:
        try:
            seed = paths.cell(node.goal.x, node.goal.y)
        except MapError as error:
            raise MapError(f"the goal of {node.name!r}: {error}") from None
        if seed in seeds:
            raise MapError(f"the goals of {graph.names[seeds.index(seed)]!r} and {node.name!r} are one cell")
        seeds.append(seed)
    clearance = Grid(grid.frame, open_cells, grid.occupied & ~open_cells).clearance()
    report_share(_WORK, _CLEARANCE)
    regions = _peaks(clearance, open_cells)
    report_share(_WORK, _PEAKS)
    forest, found = _forest(regions, clearance, open_cells)
    for left, right, saddle in found:
        forest.join_if_low(left, right, saddle)
    forest.seeded = {forest.root(int(regions[seed])) for seed in seeds}
    for left, right, _ in found:
        forest.join_if_unseeded(left, right)
    regions = forest.joined(regions)
    raster = np.zeros(grid.frame.shape, dtype=np.uint16)
    seeded = np.unique(regions[tuple(np.transpose(seeds))])
    for number, region in enumerate(seeded):
        report_share(_WORK, _JOINED + (1 - _JOINED) * number / len(seeded))
        inside = [index for index, seed in enumerate(seeds) if regions[seed] == region]
        cells = (regions == region) & open_cells
        shares = _divided(Paths(grid.frame, cells), [seeds[index] for index in inside])
        raster[cells] = np.array([*inside, -1])[shares[cells]] + 1
    raster[~grid.free] = 0
    report_share(_WORK, 1.0)
    return Labels(grid.frame, raster, graph.names)


def rooms(grid: Grid, reached: Mask, least: float) -> Regions:
    """Divide the free cells of a grid at possible doors, without goals; return regions by one of their cells.

    Regions are joined where the passage between them is no door, and where one is too small for a room.

    Args:
        grid: The floor.
        reached: The cells that count for the size of a room.
        least: The square metres of a room.
    """
    open_cells = _without_specks(grid)
    clearance = Grid(grid.frame, open_cells, grid.occupied & ~open_cells).clearance()
    regions = _peaks(clearance, open_cells)
    forest, found = _forest(regions, clearance, open_cells)
    for left, right, saddle in found:
        forest.join_if_no_door(left, right, saddle)
    sizes = np.bincount(regions[reached], minlength=clearance.size).astype(np.float64) * grid.frame.resolution**2
    forest.join_small(found, sizes, least)
    return forest.joined(regions)


def _without_specks(grid: Grid) -> Mask:
    """Return the cells that are free but for specks."""
    found, count = scipy.ndimage.label(~grid.free, structure=np.ones((3, 3)))
    sizes = np.bincount(found.ravel(), minlength=count + 1) * grid.frame.resolution**2
    speck = sizes < _SPECK
    speck[0] = False
    open_cells: Mask = grid.free | speck[found]
    return open_cells


def _divided(paths: Paths, seeds: Sequence[tuple[int, int]]) -> Regions:
    """Return for each cell of a region the index of its goal, -1 where none can be reached."""
    shares = np.full(paths.frame.shape, 0 if len(seeds) == 1 else -1)
    if len(seeds) == 1:
        return shares
    nearest = np.full(paths.frame.shape, np.inf)
    rows, columns = np.indices(paths.frame.shape)
    for index, seed in enumerate(seeds):
        distance = np.where(seen_from(paths.open, seed), np.hypot(rows - seed[0], columns - seed[1]), np.inf)
        shares[distance < nearest] = index
        nearest = np.minimum(nearest, distance)
    for index, seed in enumerate(seeds):
        parts, _ = scipy.ndimage.label(shares == index)
        shares[(shares == index) & (parts != parts[seed])] = -1  # an island, seen through a gap
    given = np.argwhere(shares >= 0)
    _, source = paths.distances([(int(row), int(column)) for row, column in given])
    rest = paths.open & (shares < 0) & (source >= 0)
    shares[rest] = shares[tuple(given[source[rest]].T)]
    return shares


def _peaks(clearance: Vector, open_cells: Mask) -> Regions:
    """Return for each cell the index of the peak that the steepest way up from it leads to."""
    count = clearance.size
    rank = np.empty(count, dtype=np.intp)
    rank[np.argsort(clearance, axis=None, kind="stable")] = np.arange(count)
    ranks = np.where(open_cells, rank.reshape(clearance.shape), -1)
    best, up = ranks.copy(), np.arange(count).reshape(clearance.shape)
    cells = up.copy()
    for here, there in _neighbours(clearance.shape):
        for one, other in ((here, there), (there, here)):
            higher = ranks[other] > best[one]
            best[one] = np.where(higher, ranks[other], best[one])
            up[one] = np.where(higher, cells[other], up[one])
    flat = up.ravel()
    while (flat[flat] != flat).any():
        flat = flat[flat]
    return flat.reshape(clearance.shape)


def _neighbours(shape: tuple[int, ...]) -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Return the pairs of cells that share a side, as slices: above and below, left and right."""
    rows, columns = shape
    whole_rows, whole_columns = slice(0, rows), slice(0, columns)
    return [
        ((slice(0, rows - 1), whole_columns), (slice(1, rows), whole_columns)),
        ((whole_rows, slice(0, columns - 1)), (whole_rows, slice(1, columns))),
    ]


def _forest(regions: Regions, clearance: Vector, open_cells: Mask) -> tuple[_Forest, list[tuple[int, int, float]]]:
    """Return regions, none of which is joined, and the passages between them with their clearance, the widest first."""
    ones, others, widths = [], [], []
    for here, there in _neighbours(clearance.shape):
        border = open_cells[here] & open_cells[there] & (regions[here] != regions[there])
        ones.append(np.minimum(regions[here][border], regions[there][border]))
        others.append(np.maximum(regions[here][border], regions[there][border]))
        widths.append(np.minimum(clearance[here][border], clearance[there][border]))
    one, other, width = np.concatenate(ones), np.concatenate(others), np.concatenate(widths)
    order = np.lexsort((other, one, -width))
    # Only the widest cell between two regions can join them: where it does not, no narrower one does.
    _, widest = np.unique((one * clearance.size + other)[order], return_index=True)
    order = order[np.sort(widest)]
    found = list(zip(one[order].tolist(), other[order].tolist(), width[order].tolist(), strict=True))
    return _Forest(np.unique(regions[open_cells]).tolist(), clearance.ravel()), found


class _Forest:
    """Regions that are joined: each tree is one."""

    def __init__(self, regions: list[int], clearance: Vector) -> None:
        self.parents = {region: region for region in regions}
        self.peaks = {region: float(clearance[region]) for region in regions}
        self.seeded: set[int] = set()

    def root(self, region: int) -> int:
        while (above := self.parents[region]) != region:
            self.parents[region] = self.parents[above]
            region = above
        return region

    def join_if_low(self, one: int, other: int, saddle: float) -> None:
        """Join two where the lower peak hardly rises above the passage between them."""
        low, high = sorted((self.root(one), self.root(other)), key=lambda root: (self.peaks[root], root))
        if low != high and self.peaks[low] - saddle < _RISE:
            self.parents[low] = high

    def join_if_no_door(self, one: int, other: int, saddle: float) -> None:
        """Join two where the passage between them is wide, or nearly as wide as the narrower, and that as the other."""
        low, high = sorted((self.root(one), self.root(other)), key=lambda root: (self.peaks[root], root))
        narrow, wide = self.peaks[low], self.peaks[high]
        alike_and_open = saddle >= _DOOR * narrow and narrow >= _ALIKE * wide
        if low != high and (alike_and_open or 2 * saddle >= _WIDE):
            self.parents[low] = high

    def join_small(self, found: Sequence[tuple[int, int, float]], sizes: Vector, least: float) -> None:
        """Join regions that are too small through their widest passages, until none is."""
        areas: dict[int, float] = {}
        for region in self.parents:
            root = self.root(region)
            areas[root] = areas.get(root, 0.0) + float(sizes[region])
        joined = True
        while joined:
            joined = False
            for left, right, _ in found:
                one, other = sorted((self.root(left), self.root(right)), key=lambda root: (areas[root], root))
                if one != other and areas[one] < least:
                    self.parents[one] = other
                    areas[other] += areas[one]
                    joined = True

    def joined(self, regions: Regions) -> Regions:
        """Return for each cell the root of its region."""
        roots = np.arange(regions.size)
        for region in self.parents:
            roots[region] = self.root(region)
        return roots[regions]

    def join_if_unseeded(self, one: int, other: int) -> None:
        """Join two unless both hold a goal."""
        one, other = self.root(one), self.root(other)
        if one != other and not (one in self.seeded and other in self.seeded):
            if one in self.seeded:
                one, other = other, one
            self.parents[one] = other


def propose(grid: Grid, *, radius: float = 0.25, margin: float = 0.3, least: float = _LEAST) -> Graph:
    """Propose a graph of places for a grid: rooms, a goal in each, and a way in either direction through each door.

    Rooms are called ``Room1`` and so on, from the upper left to the lower right.

    Args:
        grid: The floor.
        radius: Of the robot, in metres.
        margin: How deep inside a place a robot must be that comes into it, in metres.
        least: The square metres of a room that a robot can reach; smaller ones belong to their neighbours.

    Raises:
        MapError: If the robot fits nowhere, or a length is none.
    """
    check_metres(radius, "the radius")
    check_metres(margin, "the margin")
    check_metres(least, "the least area")
    parts, count = scipy.ndimage.label(drivable(grid, radius))
    if not count:
        raise MapError(f"a robot with a radius of {radius:g} m fits nowhere on this map")
    reached: Mask = parts == 1 + int(np.bincount(parts.ravel())[1:].argmax())  # the largest part
    regions = rooms(grid, reached, least)
    numbers = np.unique(regions[reached])
    raster = np.searchsorted(numbers, regions).astype(np.uint16) + 1
    raster[~np.isin(regions, numbers)] = 0
    labels = Labels(grid.frame, raster, tuple(f"Room{index}" for index in range(1, len(numbers) + 1)))
    for _ in range(_ROUNDS):  # a draft from goals has other borders than the regions, and goals lie off borders
        nodes = _goals(labels, grid, reached, radius, margin)
        labels = draft(grid, Graph(nodes, ()))
    driven = drivable(grid, radius)
    pairs = [passage.places for passage in passages(labels, grid) if leads(passage, driven)]
    index = labels.names.index
    both = sorted(
        {pair for one, other in pairs for pair in ((one, other), (other, one))},
        key=lambda pair: (index(pair[0]), index(pair[1])),
    )
    return Graph(nodes, tuple(Edge(source, target, f"to {target}") for source, target in both))


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
