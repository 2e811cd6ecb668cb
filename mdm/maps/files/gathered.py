"""The places and ways of a file, gathered one by one, so that each error has its line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.maps.graph import Edge, Graph, Node

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import NoReturn

    Fail = Callable[[str], NoReturn]

_FAR = 1e9
"""Metres that are on no map: more than the way around the Earth."""


class Gathered:
    """The places and ways that a reader has met.

    Each comes with a function that raises an error at its place in the file.
    """

    def __init__(self) -> None:
        self._nodes: dict[str, Node] = {}
        self._edges: dict[tuple[str, str], tuple[Edge, Fail]] = {}

    @property
    def names(self) -> list[str]:
        """The places so far."""
        return list(self._nodes)

    def add_node(self, node: Node, fail: Fail) -> None:
        """Add a place."""
        _check_name(node.name, "a place", fail)
        for x, y in ((node.goal.x, node.goal.y), *(node.zone or ())):
            if max(abs(x), abs(y)) > _FAR:
                fail(f"{node.name!r} lies at {x:g}, {y:g}: metres were expected, less than {_FAR:g}")
        if node.name in self._nodes:
            fail(f"a second place is called {node.name!r}")
        self._nodes[node.name] = node

    def add_edge(self, edge: Edge, fail: Fail) -> None:
        """Add a way; of two with the same ends and label the cheaper one counts."""
        _check_name(edge.label, f"a way from {edge.source!r}", fail)
        before = self._edges.setdefault((edge.source, edge.label), (edge, fail))[0]
        if before.target != edge.target:
            fail(f"from {edge.source!r} two ways are called {edge.label!r}: to {before.target!r} and {edge.target!r}")
        if (edge.cost or 0.0) < (before.cost or 0.0):
            self._edges[edge.source, edge.label] = edge, fail

    def graph(self, fail: Fail) -> Graph:
        """Return the graph of all; `fail` is for the file as a whole."""
        if not self._nodes:
            fail("the file has no places")
        for edge, fail_there in self._edges.values():
            for name in (edge.source, edge.target):
                if name not in self._nodes:
                    fail_there(
                        f"a way leads from {edge.source!r} to {edge.target!r}, and there is no place {name!r}; there "
                        f"are {', '.join(self._nodes)}"
                    )
        return Graph(tuple(self._nodes.values()), tuple(edge for edge, _ in self._edges.values()))


def _check_name(name: str, what: str, fail: Fail) -> None:
    """Refuse names that cannot be read in a table, or be given as arguments."""
    if not name.strip():
        fail(f"{what} has no name")
    if not name.isprintable():
        fail(f"{what} is called {name!r}: names have no line breaks and no other control characters")
