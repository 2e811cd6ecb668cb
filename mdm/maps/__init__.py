"""Maps: where the cells of a floor are free, which place each belongs to, and how the places hang together.

With `Places` a robot's poses are predicates and events, and with `Navigation` the ways of a map are actions. Names that
take actors are loaded when they are first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mdm.maps.check import Problem, check
from mdm.maps.draft import draft, propose
from mdm.maps.files import load_floors, load_graph, load_grid, load_map, save_graph, save_labels
from mdm.maps.graph import Edge, Graph, Node, Pose
from mdm.maps.map import Floors, Lift, Map
from mdm.maps.paths import Passage, passages
from mdm.maps.raster import Frame, Grid, Labels

if TYPE_CHECKING:
    from mdm.maps.navigation import LiftNavigator, Navigation, Navigator, ReportingNavigator
    from mdm.maps.place_belief import PlaceBelief
    from mdm.maps.places import Places, PlacesOptions

__all__ = [
    "Edge",
    "Floors",
    "Frame",
    "Graph",
    "Grid",
    "Labels",
    "Lift",
    "LiftNavigator",
    "Map",
    "Navigation",
    "Navigator",
    "Node",
    "Passage",
    "PlaceBelief",
    "Places",
    "PlacesOptions",
    "Pose",
    "Problem",
    "ReportingNavigator",
    "check",
    "draft",
    "load_floors",
    "load_graph",
    "load_grid",
    "load_map",
    "passages",
    "propose",
    "save_graph",
    "save_labels",
]

_HOMES = {
    "LiftNavigator": "navigation",
    "Navigation": "navigation",
    "Navigator": "navigation",
    "PlaceBelief": "place_belief",
    "Places": "places",
    "PlacesOptions": "places",
    "ReportingNavigator": "navigation",
}


def __getattr__(name: str) -> Any:
    """Load a public name that takes actors when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'mdm.maps' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"mdm.maps.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return list(__all__)
