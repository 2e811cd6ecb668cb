"""Maps: where the cells of a floor are free, which place each belongs to, and how the places hang together."""

from mdm.maps.draft import draft
from mdm.maps.frame import Frame
from mdm.maps.graph import Edge, Graph, Node, Pose
from mdm.maps.grid import Grid
from mdm.maps.labels import Labels
from mdm.maps.map import Map

__all__ = ["Edge", "Frame", "Graph", "Grid", "Labels", "Map", "Node", "Pose", "draft"]
