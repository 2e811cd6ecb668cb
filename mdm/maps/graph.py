"""The graph of places: where each is entered, and by which actions one comes from one to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

from mdm.errors import MapError

__all__ = ["Edge", "Graph", "Node", "Pose"]


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a robot is, or should be.

    Args:
        x: In metres.
        y: In metres.
        yaw: Where it looks, from the world's x axis anticlockwise, in radians.
        floor: The floor in whose frame this is, where there are several.
    """

    x: float
    y: float
    yaw: float = 0.0
    floor: str = field(default="", kw_only=True)

    @property
    def is_finite(self) -> bool:
        """Whether all its numbers are finite."""
        return math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.yaw)


@dataclass(frozen=True, slots=True)
class Node:
    """A place.

    Args:
        name: Its name; that of the predicate that is true there.
        goal: Where a robot goes that is sent there.
        zone: The corners of the polygon that it covers, in metres in the world, where the graph knows.
        tolerance: How near to the goal counts as arrived, in metres, where the graph knows.
    """

    name: str
    goal: Pose
    zone: tuple[tuple[float, float], ...] | None = None
    tolerance: float | None = None


@dataclass(frozen=True, slots=True)
class Edge:
    """A way from a place to another one.

    Args:
        source: The name of the place that it leads from.
        target: The name of the place that it leads to.
        label: The action that takes it, such as ``Up``.
        cost: What it costs, where the graph knows.
        lift: What it takes to another floor, where it is not driven.
        seconds: How long that takes.
    """

    source: str
    target: str
    label: str
    cost: float | None = None
    lift: str | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Graph:
    """Places, and the labelled ways between them.

    Args:
        nodes: The places.
        edges: The ways. From a place at most one has a given label.

    Raises:
        MapError: If there is no place, two share a name, a name or label is no text, a goal or zone is not finite, a
            tolerance is not above 0, a way begins or ends nowhere, or two ways from a place have the same label.
    """

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]

    def __post_init__(self) -> None:
        if not self.nodes:
            raise MapError("the graph has no places")
        known: set[str] = set()
        for node in self.nodes:
            _check(node)
            if node.name in known:
                raise MapError(f"two places are called {node.name!r}")
            known.add(node.name)
        taken: dict[tuple[str, str], str] = {}
        for edge in self.edges:
            for end in (edge.source, edge.target):
                if end not in known:
                    raise MapError(
                        f"a way leads from {edge.source!r} to {edge.target!r}, and there is no place {end!r}; "
                        f"there are {', '.join(self.names)}"
                    )
            if not isinstance(edge.label, str) or not edge.label:
                raise MapError(
                    f"the way from {edge.source!r} to {edge.target!r} is called {edge.label!r}: give it a label"
                )
            before = taken.setdefault((edge.source, edge.label), edge.target)
            if before != edge.target:
                raise MapError(
                    f"from {edge.source!r} two ways are called {edge.label!r}: to {before!r} and to {edge.target!r}"
                )

    @cached_property
    def _by_name(self) -> dict[str, Node]:
        return {node.name: node for node in self.nodes}

    @cached_property
    def _ways(self) -> dict[tuple[str, str], Edge]:
        return {(edge.source, edge.label): edge for edge in self.edges}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the places."""
        return tuple(node.name for node in self.nodes)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The labels of the ways, in the order in which they first occur."""
        return tuple(dict.fromkeys(edge.label for edge in self.edges))

    def node(self, name: str) -> Node:
        """Return a place.

        Raises:
            MapError: If there is none of that name.
        """
        try:
            return self._by_name[name]
        except KeyError:
            raise MapError(f"there is no place {name!r}; there are {', '.join(self.names)}") from None

    def target(self, source: str, label: str) -> str | None:
        """Return where the way of a label leads to from a place; None where there is no such way."""
        way = self.way(source, label)
        return None if way is None else way.target

    def way(self, source: str, label: str) -> Edge | None:
        """Return the way of a label from a place; None where there is no such way."""
        return self._ways.get((source, label))


def _check(node: Node) -> None:
    """Refuse a place whose name, goal, zone or tolerance is none."""
    if not isinstance(node.name, str) or not node.name:
        raise MapError(f"a place is called {node.name!r}: give it a name")
    if not node.goal.is_finite:
        raise MapError(f"the goal of {node.name!r} is {node.goal}, which is not finite")
    if node.zone is not None and len(node.zone) < 3:
        raise MapError(f"the zone of {node.name!r} has {len(node.zone)} corners; 3 or more make an area")
    if not all(math.isfinite(x) and math.isfinite(y) for x, y in node.zone or ()):
        raise MapError(f"the zone of {node.name!r} has a corner that is not finite")
    if node.tolerance is not None and not 0 < node.tolerance < math.inf:
        raise MapError(f"the tolerance of {node.name!r} is {node.tolerance}: give metres above 0")
