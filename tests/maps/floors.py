"""Floors drawn for the tests: six rooms each, with doors or without, with furniture and specks."""

from __future__ import annotations

import numpy as np

from mdm.maps import Edge, Frame, Graph, Grid, Labels, Map, Node, Pose


class Floor:
    """Rooms as rectangles in metres, walls between them, doors as gaps, and what stands about, in cells of a side."""

    def __init__(self, width, height, rooms, doors, *, furniture=(), specks=0, wall=0.15, seed=0, side=0.05):
        self.frame = Frame(round(height / side), round(width / side), side, -2.0, -1.0)
        self.rooms, self.doors = rooms, doors
        free = np.zeros(self.frame.shape, dtype=bool)
        truth = np.zeros(self.frame.shape, dtype=np.uint16)
        xs, ys = self.frame.centres()
        xs, ys = xs + 2.0, ys + 1.0
        for label, (left, low, right, high) in enumerate(rooms.values(), 1):
            whole = (xs > left) & (xs < right) & (ys > low) & (ys < high)
            inside = (xs > left + wall / 2) & (xs < right - wall / 2) & (ys > low + wall / 2) & (ys < high - wall / 2)
            truth[whole] = label
            free |= inside
        for left, low, right, high in doors.values():
            free |= (xs > left) & (xs < right) & (ys > low) & (ys < high)
        for left, low, right, high in furniture:
            free &= ~((xs > left) & (xs < right) & (ys > low) & (ys < high))
        random = np.random.default_rng(seed)
        for _ in range(specks):
            row, column = (random.integers(2, size - 4) for size in self.frame.shape)
            free[row : row + 3, column : column + 2] = False
        self.grid = Grid(self.frame, free, ~free)
        truth[~free] = 0
        self.labels = Labels(self.frame, truth, tuple(rooms))

    def neighbours(self):
        """Return the pairs of rooms that a door joins."""
        return {tuple(sorted(pair)) for pair in self.doors}

    def graph(self, points=None):
        """Return a graph with a goal at the centre of each room, or at given points."""
        nodes = []
        for name, (left, low, right, high) in self.rooms.items():
            x, y = ((left + right) / 2 - 2.0, (low + high) / 2 - 1.0) if points is None else points[name]
            nodes.append(Node(name, Pose(x, y)))
        edges = [Edge(*ends, f"to {ends[1]}") for pair in self.doors for ends in (pair, pair[::-1])]
        return Graph(tuple(nodes), tuple(edges))

    def random_points(self, random, clearance=0.3):
        """Return a free point in each room, some way from walls."""
        clear = self.grid.clearance() > clearance
        points = {}
        for label, name in enumerate(self.rooms, 1):
            cells = np.argwhere((self.labels.raster == label) & clear)
            points[name] = self.frame.centre(*cells[random.integers(len(cells))])
        return points

    def map(self):
        """Return the whole."""
        return Map(self.labels, self.graph(), self.grid)


def touching(labels):
    """Return the pairs of places that share a side of cells."""
    raster, pairs = labels.raster, set()
    for one, other in ((raster[:-1], raster[1:]), (raster[:, :-1], raster[:, 1:])):
        border = (one != other) & (one > 0) & (other > 0)
        both = {(int(a), int(b)) for a, b in zip(one[border], other[border], strict=True)}
        pairs |= {tuple(sorted((labels.names[a - 1], labels.names[b - 1]))) for a, b in both}
    return pairs


def offices(**options):
    """Return six rooms along a corridor, with doors."""
    rooms = {
        "hall": (0.0, 7.0, 22.0, 9.5),
        "west": (0.0, 0.0, 7.0, 7.0),
        "middle": (7.0, 0.0, 14.0, 7.0),
        "east": (14.0, 0.0, 22.0, 7.0),
        "kitchen": (0.0, 9.5, 10.0, 18.0),
        "lab": (10.0, 9.5, 22.0, 18.0),
    }
    doors = {
        ("hall", "west"): (3.0, 6.7, 4.0, 7.3),
        ("hall", "middle"): (10.0, 6.7, 11.0, 7.3),
        ("east", "hall"): (18.0, 6.7, 19.0, 7.3),
        ("hall", "kitchen"): (5.0, 9.2, 6.0, 9.8),
        ("hall", "lab"): (15.0, 9.2, 16.0, 9.8),
        ("kitchen", "lab"): (9.7, 13.0, 10.3, 14.0),
    }
    return Floor(22.0, 18.0, rooms, doors, **options)


def corridors(**options):
    """Return corridors around a corner that no door marks, and rooms that open far from it.

    Where in the corridors the border lies is a convention: half way between the points that stand for them.
    """
    rooms = {
        "south": (0.0, 6.0, 16.0, 8.5),
        "west": (0.0, 8.5, 2.5, 18.0),
        "coffee": (2.5, 8.5, 9.0, 14.0),
        "laboratory": (0.0, 0.0, 8.0, 6.0),
        "workshop": (8.0, 0.0, 16.0, 6.0),
        "store": (9.0, 8.5, 16.0, 14.0),
    }
    doors = {
        ("south", "west"): (0.075, 8.3, 2.425, 8.7),
        ("coffee", "store"): (8.7, 11.0, 9.3, 12.0),
        ("south", "workshop"): (12.0, 5.7, 13.0, 6.3),
        ("south", "store"): (12.0, 8.2, 13.0, 8.8),
        ("laboratory", "workshop"): (7.7, 2.0, 8.3, 3.0),
    }
    return Floor(16.5, 18.0, rooms, doors, **options)


def flat(**options):
    """Return a flat: rooms of all sizes, wide openings and narrow doors."""
    rooms = {
        "entrance": (0.0, 0.0, 3.0, 4.0),
        "living": (3.0, 0.0, 10.0, 6.0),
        "kitchen": (10.0, 0.0, 14.0, 6.0),
        "bath": (0.0, 4.0, 3.0, 8.0),
        "bedroom": (3.0, 6.0, 8.0, 11.0),
        "study": (8.0, 6.0, 14.0, 11.0),
    }
    doors = {
        ("entrance", "living"): (2.8, 1.0, 3.2, 2.2),
        ("kitchen", "living"): (9.8, 1.5, 10.2, 2.8),
        ("bath", "entrance"): (1.0, 3.8, 1.9, 4.2),
        ("bedroom", "living"): (4.5, 5.8, 5.4, 6.2),
        ("kitchen", "study"): (11.5, 5.8, 12.4, 6.2),
    }
    return Floor(14.5, 11.5, rooms, doors, **options)


FURNITURE = {
    offices: (
        (1.0, 1.0, 3.0, 1.8),
        (7.8, 4.5, 9.3, 5.5),
        (16.0, 1.0, 17.0, 4.0),
        (2.0, 14.0, 4.0, 15.5),
        (13.0, 12.0, 17.0, 13.0),
    ),
    corridors: ((3.0, 10.5, 4.5, 12.0), (3.0, 2.0, 5.0, 3.5), (10.5, 2.0, 12.0, 3.0), (11.0, 11.0, 13.0, 12.0)),
    flat: ((5.0, 2.0, 7.5, 3.5), (4.0, 9.0, 6.0, 10.8), (9.0, 9.0, 11.0, 10.0), (0.3, 6.0, 1.0, 7.6)),
}
