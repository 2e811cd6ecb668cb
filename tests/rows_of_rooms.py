"""Floors that tests of maps share: rooms beside each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mdm.maps import Edge, Frame, Graph, Labels, Map, Node, Pose

SIDE = 0.05


def row_of_rooms(*names, width=4.0, height=4.0, gap=0.0, x=0.0, y=0.0):
    """Return a map of rooms from left to right, each as wide as said, with a goal in its middle; Left and Right."""
    columns, rows, walls = round(width / SIDE), round(height / SIDE), round(gap / SIDE)
    strips = []
    for label in range(1, len(names) + 1):
        strips += [np.full((rows, columns), label), np.zeros((rows, walls))]
    raster = np.hstack(strips[:-1]).astype(np.uint16)
    frame = Frame(*raster.shape, SIDE, x, y)
    middle = [Pose(x + (width + gap) * index + width / 2, y + height / 2) for index in range(len(names))]
    nodes = tuple(Node(name, goal) for name, goal in zip(names, middle, strict=True))
    edges = [Edge(a, b, "Right") for a, b in pairwise(names)]
    edges += [Edge(b, a, "Left") for a, b in pairwise(names)]
    return Map(Labels(frame, raster, names), Graph(nodes, tuple(edges)))
