"""Maps: labels and graph fit each other."""

from __future__ import annotations

import numpy as np
from sentences import refused

from mdm.errors import MapError
from mdm.maps import Frame, Graph, Grid, Labels, Map, Node, Pose

FRAME = Frame(1, 2, 1.0)
LABELS = Labels(FRAME, np.array([[1, 2]], dtype=np.uint16), ("a", "b"))


def graph(*names):
    return Graph(tuple(Node(name, Pose(0, 0)) for name in names), ())


def test_the_names_of_labels_and_graph_are_the_same():
    assert Map(LABELS, graph("b", "a")).graph.names == ("b", "a")
    with refused(MapError):
        Map(LABELS, graph("a"))
    with refused(MapError):
        Map(LABELS, graph("a", "b", "c"))


def test_the_grid_lies_as_the_labels_do():
    free = np.ones((1, 2), dtype=bool)
    assert Map(LABELS, graph("a", "b"), Grid(FRAME, free, ~free)).grid is not None
    with refused(MapError):
        Map(LABELS, graph("a", "b"), Grid(Frame(1, 2, 0.5), free, ~free))
