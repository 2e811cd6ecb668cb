"""The files that maps are read from, a module per kind of file."""

from mdm.maps.files.building import load_floors
from mdm.maps.files.image import save_labels
from mdm.maps.files.load import load_graph, load_map
from mdm.maps.files.occupancy import load_grid
from mdm.maps.files.topological_map import save_graph

__all__ = ["load_floors", "load_graph", "load_grid", "load_map", "save_graph", "save_labels"]
