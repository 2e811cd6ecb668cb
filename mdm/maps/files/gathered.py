"""The places and ways of a file, gathered one by one, so that what is wrong is told with its line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.maps.graph import Edge, Graph, Node

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import NoReturn

    Fail = Callable[[str], NoReturn]

__all__ = ["Gathered"]


class Gathered:
    """The places and ways that a reader has met.

    Each comes with a function that raises an error at its place in the file.
    """

    def __init__(self) -> None:
        self._nodes: dict[str, Node] = {}
        self._edges: dict[tuple[str, str], tuple[Edge, Fail]] = {}

    def add_node(self, node: Node, fail: Fail) -> None:
        """Add a place."""
        if node.name in self._nodes:
            fail(f"a second place is called {node.name!r}")
        self._nodes[node.name] = node

    def add_edge(self, edge: Edge, fail: Fail) -> None:
        """Add a way; of two with the same ends and label the cheaper one counts."""
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
