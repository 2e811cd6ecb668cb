"""The map: a floor's grid, its labels and its graph, in the one form that all readers give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mdm.errors import MapError

if TYPE_CHECKING:
    from mdm.maps.graph import Graph
    from mdm.maps.grid import Grid
    from mdm.maps.labels import Labels

__all__ = ["Map"]


@dataclass(frozen=True, eq=False)
class Map:
    """A floor.

    Args:
        labels: Which place each cell belongs to.
        graph: How the places hang together.
        grid: Which cells are free, where that is known.

    Raises:
        MapError: If the grid and the labels lie differently, or names of the one are unknown to the other.
    """

    labels: Labels
    graph: Graph
    grid: Grid | None = None

    def __post_init__(self) -> None:
        if self.grid is not None and self.grid.frame != self.labels.frame:
            raise MapError(f"the labels lie as {self.labels.frame}, the grid as {self.grid.frame}")
        for some, others, where in (
            (self.labels.names, self.graph.names, "the graph"),
            (self.graph.names, self.labels.names, "the labels"),
        ):
            missing = [name for name in some if name not in others]
            if missing:
                raise MapError(f"{', '.join(map(repr, missing))}: not in {where}, which has {', '.join(others)}")
