"""Paths over the free cells of a grid, the view from a cell, and passages straight from place to place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from mdm.errors import MapError
from mdm.maps.raster import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mdm.maps.raster import Grid, Labels
    from mdm.models.matrices import Vector

PATH_MARGIN = 0.05
"""Metres that a robot needs on each side, beside its radius: in paths, in driving, and in checks."""
WALL_GAP = 0.01
"""Metres left between a robot and the edges of walls, where these end and not where the centres of their cells are."""
_SLACK = 1e-9
"""Metres by which lengths differ that are meant to be the same."""
_LEAST = 50
"""Cells around the ends of ways where one looks first."""
_STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, math.sqrt(2)), (1, -1, math.sqrt(2)))
_OPEN = 0.8
"""The share of the width of the narrower of two places from which a passage divides nothing."""
_FEW = 8
"""Places of which so many may be conventions without being a route."""


def needed_clearance(grid: Grid, radius: float) -> float:
    """Return the clearance, in metres between centres of cells, that a robot of a radius needs to drive.

    It has `PATH_MARGIN` to spare; on a coarse grid more, for walls reach half a cell beyond the centres of theirs.
    """
    return radius + max(PATH_MARGIN, grid.frame.resolution / 2 + WALL_GAP)


def drivable(grid: Grid, radius: float) -> NDArray[np.bool_]:
    """Return over which cells a robot of a radius in metres can drive: with `needed_clearance`, past all corners."""
    open_cells = grid.fits(needed_clearance(grid, radius))
    if math.sqrt(0.5) * grid.frame.resolution + WALL_GAP > PATH_MARGIN:  # else no corner reaches so far
        open_cells &= grid.clearance_to_edges() >= radius + WALL_GAP - _SLACK
    return open_cells


class Paths:
    """The shortest ways over cells, to the eight neighbours of each, diagonally only where both cells beside are open.

    Distances are those of a chain of cells: at most 8 % longer than the straight ones.

    Args:
        frame: Where the cells lie.
        open_cells: The cells that may be driven over, such as `Grid.free`, or those of some clearance.
    """

    def __init__(self, frame: Frame, open_cells: NDArray[np.bool_]) -> None:
        self.frame = frame
        self.open = open_cells

    @cached_property
    def _index(self) -> NDArray[np.int32]:
        index = np.full(self.frame.shape, -1, dtype=np.int32)
        index[self.open] = np.arange(np.count_nonzero(self.open))
        return index

    @cached_property
    def _graph(self) -> Any:
        from scipy.sparse import csr_array  # noqa: PLC0415 - slow to import

        rows, columns = self.frame.shape
        ones: list[NDArray[np.int32]] = []
        others: list[NDArray[np.int32]] = []
        costs: list[Vector] = []
        for down, right, cost in _STEPS:
            left = max(0, -right)
            here = (slice(0, rows - down), slice(left, columns - max(0, right)))
            there = (slice(down, rows), slice(left + right, columns - max(0, right) + right))
            both = self.open[here] & self.open[there]
            if down and right:
                beside = (slice(0, rows - down), there[1]), (slice(down, rows), here[1])
                both &= self.open[beside[0]] & self.open[beside[1]]
            ones.append(self._index[here][both])
            others.append(self._index[there][both])
            costs.append(np.full(len(ones[-1]), cost * self.frame.resolution))
        one, other, cost_of = np.concatenate(ones), np.concatenate(others), np.concatenate(costs)
        count = int(self._index.max()) + 1
        entries = np.concatenate([one, other]), np.concatenate([other, one])
        return csr_array((np.concatenate([cost_of, cost_of]), entries), shape=(count, count))

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the cell that a point lies in.

        Raises:
            MapError: If it lies outside, or in a cell that is not open.
        """
        cell = self.frame.cell(x, y)
        if cell is None:
            raise MapError(f"the point {x:g}, {y:g} lies outside the map")
        if not self.open[cell]:
            raise MapError(f"the point {x:g}, {y:g} lies in a wall, or where nothing is known")
        return cell

    def distances(self, cells: Sequence[tuple[int, int]]) -> tuple[Vector, NDArray[np.intp]]:
        """Return for each cell the metres to the nearest of some cells, and the index of that one.

        Where there is no way the distance is infinite and the index -1.
        """
        from scipy.sparse.csgraph import dijkstra  # noqa: PLC0415 - slow to import

        sources = [int(self._index[cell]) for cell in cells]
        if -1 in sources:
            raise MapError(f"cell {cells[sources.index(-1)]} is not open")
        near, _, origin = dijkstra(
            self._graph, directed=False, indices=sources, min_only=True, return_predecessors=True
        )
        distances = np.full(self.frame.shape, math.inf)
        nearest = np.full(self.frame.shape, -1)
        place = np.full(int(self._index.max()) + 1, -1)
        place[sources] = np.arange(len(sources))
        distances[self.open] = near
        nearest[self.open] = np.where(origin >= 0, place[np.maximum(origin, 0)], -1)
        return distances, nearest

    def length(self, cell: tuple[int, int], target: tuple[int, int]) -> float:
        """Return the metres from a cell to another one, infinite where there is no way.

        They are those of `distances`, which looks at the whole floor. Here one looks at a window around both, and at a
        larger one until whatever leaves it would be longer: a short way on a large floor costs little.
        """
        distances, one, _, _ = self._window(cell, target)
        return float(distances[one])

    def way(self, cell: tuple[int, int], target: tuple[int, int]) -> list[tuple[int, int]]:
        """Return the cells where the shortest way from a cell to another one turns, with both ends; none where none is.

        It costs as much as `length`.
        """
        distances, one, first, paths = self._window(cell, target)
        if not math.isfinite(distances[one]):
            return []
        down, right = (int(number) for number in first)
        return [cell, *((row + down, column + right) for row, column in paths.route(distances, one))]

    def _window(
        self, cell: tuple[int, int], target: tuple[int, int]
    ) -> tuple[Vector, tuple[int, int], NDArray[np.intp], Paths]:
        """Return the metres to a target in a window that holds the way, the cell there, its corner, and its paths."""
        ends = np.array([cell, target])
        low, high = ends.min(axis=0), ends.max(axis=0)
        around = max(_LEAST, int((high - low).max()) // 8)
        while True:
            first = np.maximum(low - around, 0)
            last = np.minimum(high + around + 1, self.frame.shape)
            window = self.open[first[0] : last[0], first[1] : last[1]]
            one, other = ((int(row), int(column)) for row, column in ends - first)
            rows, columns = window.shape
            paths = Paths(Frame(rows, columns, self.frame.resolution), window)
            distances, _ = paths.distances([other])
            # To go by a line beyond both and back is as far as to the other's mirror image behind that line.
            least = math.inf
            for axis in (0, 1):
                along = float(abs(ends[0, 1 - axis] - ends[1, 1 - axis]))
                if first[axis] > 0:
                    least = min(least, math.hypot(along, float((ends[:, axis] - first[axis] + 1).sum())))
                if last[axis] < self.frame.shape[axis]:
                    least = min(least, math.hypot(along, float((last[axis] - ends[:, axis]).sum())))
            if distances[one] <= least * self.frame.resolution:
                return distances, one, first, paths
            around *= 2

    def route(self, distances: Vector, cell: tuple[int, int]) -> list[tuple[int, int]]:
        """Return the cells where the way from a cell turns, and its end: between them it runs straight over open cells.

        Args:
            distances: The metres from each cell to where it leads, as `distances` returns them.
            cell: Where it begins.
        """
        way = [cell]
        while distances[way[-1]] > 0:
            way.append(self.next(distances, way[-1]))
        turns, begin = [], 0
        for index in range(2, len(way)):
            if not sees(self.open, way[begin], way[index]):
                begin = index - 1
                turns.append(way[begin])
        return [*turns, way[-1]]

    def next(self, distances: Vector, cell: tuple[int, int]) -> tuple[int, int]:
        """Return the cell that is next on the way from a cell; the same one where it ends.

        Raises:
            MapError: If there is no way.
        """
        nearest = min(self._steps(cell), key=distances.__getitem__, default=cell)
        if distances[nearest] < distances[cell]:
            return nearest
        if distances[cell] > 0:
            raise MapError(f"there is no way from cell {cell}")
        return cell

    def _steps(self, cell: tuple[int, int]) -> list[tuple[int, int]]:
        """Return the neighbours of a cell that one comes to in a step, diagonally only past two open cells."""
        (row, column), (rows, columns) = cell, self.frame.shape
        return [
            (below, beside)
            for below in range(max(0, row - 1), min(rows, row + 2))
            for beside in range(max(0, column - 1), min(columns, column + 2))
            if self.open[below, beside]
            and self.open[row, beside]
            and self.open[below, column]
            and (below, beside) != cell
        ]


def seen_from(open_cells: NDArray[np.bool_], cell: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the cells that rays from the centre of a cell cross before they meet one that is not open.

    Two rays are at most two thirds of a cell apart at the far end, and are followed by half cells: none is missed. It
    costs up to 100 ms for 160,000 cells.
    """
    rows, columns = open_cells.shape
    reach = int(np.hypot(rows, columns)) + 1
    angles = np.linspace(0, 2 * np.pi, 14 * max(rows, columns), endpoint=False, dtype=np.float32)
    seen = np.zeros(open_cells.shape, dtype=bool)
    walled = np.pad(open_cells, 1)  # beyond the edge nothing is open
    down, right = np.sin(angles), np.cos(angles)
    for step in range(2 * reach):
        row = np.rint(cell[0] + down * (step / 2)).astype(np.intp) + 1
        column = np.rint(cell[1] + right * (step / 2)).astype(np.intp) + 1
        going = walled[row, column]
        seen[row[going] - 1, column[going] - 1] = True
        down, right = down[going], right[going]
        if not len(down):
            break
    return seen


def sees(open_cells: NDArray[np.bool_], one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether the straight line between the centres of two cells crosses open cells alone, by half cells."""
    down, right = other[0] - one[0], other[1] - one[1]
    count = 2 * max(abs(down), abs(right), 1)
    step = np.arange(count + 1)  # whole numbers: half the time of numpy's linspace
    rows = one[0] + (2 * down * step + count) // (2 * count)
    columns = one[1] + (2 * right * step + count) // (2 * count)
    return bool(open_cells[rows, columns].all())


@dataclass(frozen=True, eq=False)
class Passage:
    """A passage between two places: a stretch of their border that is free.

    Args:
        places: The names of the two, in the order of the labels.
        width: Twice the largest clearance on the border, in metres; true to a cell.
        middle: The row and the column of the cell where it is widest.
        cells: The cells on both sides of the border, as rows of row and column.
    """

    places: tuple[str, str]
    width: float
    middle: tuple[int, int]
    cells: NDArray[np.intp]


def passages(labels: Labels, grid: Grid) -> tuple[Passage, ...]:
    """Return the passages between all places, the widest first.

    Free cells without a label count for the place from which they are reached first.
    """
    places = _spread(labels.raster, grid.free)
    clearance = grid.clearance()
    borders: dict[tuple[int, int], list[NDArray[np.intp]]] = {}
    widths = np.zeros(places.shape)
    for down, right in ((1, 0), (0, 1)):
        here = slice(0, places.shape[0] - down), slice(0, places.shape[1] - right)
        there = slice(down, None), slice(right, None)
        met = (places[here] != places[there]) & (places[here] > 0) & (places[there] > 0)
        cells = np.argwhere(met)
        ones, others = places[here][met].astype(int), places[there][met].astype(int)
        narrow = np.minimum(clearance[here][met], clearance[there][met])
        step = np.array([down, right])
        for side in (cells, cells + step):
            np.maximum.at(widths, tuple(side.T), narrow)
        pairs = np.minimum(ones, others) * (len(labels.names) + 1) + np.maximum(ones, others)
        for pair in np.unique(pairs):
            key = divmod(int(pair), len(labels.names) + 1)
            chosen = cells[pairs == pair]
            borders.setdefault(key, []).extend((chosen, chosen + step))
    found = []
    for (one, other), sides in borders.items():
        for cells in _stretches(np.unique(np.concatenate(sides), axis=0)):
            along = widths[tuple(cells.T)]
            best = cells[along == along.max()]
            row, column = best[len(best) // 2].tolist()
            between = labels.names[one - 1], labels.names[other - 1]
            found.append(Passage(between, 2 * float(along.max()), (row, column), cells))
    return tuple(sorted(found, key=lambda passage: -passage.width))


def widest(found: tuple[Passage, ...]) -> dict[frozenset[str], Passage]:
    """Return the widest passage between each two places."""
    best: dict[frozenset[str], Passage] = {}
    for passage in found:
        best.setdefault(frozenset(passage.places), passage)
    return best


def leads(passage: Passage, driven: NDArray[np.bool_]) -> bool:
    """Whether a robot comes through a passage, from the cells that it can drive over."""
    return bool(driven[tuple(passage.cells.T)].any())


def undivided(labels: Labels, grid: Grid, found: tuple[Passage, ...]) -> tuple[str, ...]:
    """Return the places that nothing divides from a neighbour, where most are so: such as the points of a route.

    A passage divides where it is clearly narrower than both places are. A few places without a door between them are
    usual, and then none is returned.
    """
    wide = np.zeros(len(labels.names) + 1)
    np.maximum.at(wide, labels.raster.ravel(), grid.clearance().ravel())
    of = dict(zip(labels.names, (2 * wide[1:]).tolist(), strict=True))
    crowded = {
        name
        for passage in found
        for name in passage.places
        if passage.width >= _OPEN * min(of[place] for place in passage.places)
    }
    if len(crowded) < max(_FEW, len(labels.names) / 2):
        return ()
    return tuple(name for name in labels.names if name in crowded)


def route_sentence(crowded: int, places: int) -> str:
    """Return the sentence about places that are no rooms, with the way out."""
    return (
        f"{crowded} of {places} places have a neighbour from which nothing divides them: are these the points of a "
        f"route, and no rooms? Give the nodes of a room the same `zone` in their metadata, or begin with the rooms "
        f"that mdm map goals proposes"
    )


def _stretches(cells: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return cells in groups that touch, at corners too."""
    low = cells.min(axis=0)
    mask = np.zeros(cells.max(axis=0) - low + 1, dtype=bool)
    mask[tuple((cells - low).T)] = True
    groups, count = scipy.ndimage.label(mask, structure=np.ones((3, 3)))
    of = groups[tuple((cells - low).T)]
    return [cells[of == group] for group in range(1, count + 1)]


def _spread(raster: NDArray[np.uint16], free: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return the labels of free cells; those without one get that from which they are reached first."""
    wide = raster.shape[1] + 2
    labels = np.pad(np.where(free, raster, 0), 1).ravel()
    open_cells = np.pad(free, 1).ravel()
    edge = np.flatnonzero(labels)
    while edge.size:
        reached = []
        for step in (-wide, -1, 1, wide):
            there = edge + step
            new = open_cells[there] & (labels[there] == 0)
            labels[there[new]] = labels[edge[new]]
            reached.append(there[new])
        edge = np.concatenate(reached)
    spread: NDArray[np.uint16] = labels.reshape(-1, wide)[1:-1, 1:-1]
    return spread
