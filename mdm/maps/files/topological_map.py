"""Graphs as the original's topological tools keep them: XML, a `Node` per place.

The name of a node is that of the predicate that is true there. A `Goal` is x, y and the yaw, which may be left out and
is then 0. A `Connection` has the action that takes it as its label.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.formats.markup import escape, quoted, stream
from mdm.formats.source import number
from mdm.formats.target import write_text
from mdm.maps.files.gathered import Gathered
from mdm.maps.graph import Edge, Graph, Node, Pose

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.formats.markup import Element
    from mdm.formats.source import Source


def save_graph(graph: Graph, path: str | Path) -> None:
    """Write places, their goals and their ways as a `TopologicalMap`. Zones, tolerances and costs are left out.

    Raises:
        Error: If the file cannot be written.
    """
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<TopologicalMap>"]
    for node in graph.nodes:
        goal = f"{node.goal.x!r} {node.goal.y!r} {node.goal.yaw!r}"
        lines += [f"  <Node name={quoted(node.name)}>", f"    <Goal>{goal}</Goal>"]
        lines += [
            f"    <Connection label={quoted(edge.label)}>{escape(edge.target)}</Connection>"
            for edge in graph.edges
            if edge.source == node.name
        ]
        lines.append("  </Node>")
    write_text(path, "\n".join([*lines, "</TopologicalMap>", ""]))


def read_topological_map(source: Source) -> Graph:
    """Read a `TopologicalMap`.

    Raises:
        FormatError: If it is malformed, or a connection leads nowhere.
    """
    elements = stream(source, {"Node"})
    root = next(elements)
    if root.tag != "TopologicalMap":
        root.fail(f"<TopologicalMap> was expected, not <{root.tag}>")
    gathered = Gathered()
    for node in elements:
        if node.tag != "Node":
            node.fail(f"<Node> was expected, not <{node.tag}>")
        _add(node, gathered)
    return gathered.graph(source.fail)


def _add(node: Element, gathered: Gathered) -> None:
    name = node.attribute("name")
    connections = []
    for child in node.children:
        if child.tag == "Connections":
            connections += child.children
        elif child.tag == "Connection":
            connections.append(child)
        elif child.tag != "Goal":
            child.fail(f"<Goal>, <Connections> or <Connection> was expected, not <{child.tag}>")
    if len(node.all("Goal")) > 1:
        node.all("Goal")[1].fail(f"{name!r} has a second <Goal>")
    goal = node.need("Goal")
    words = goal.text.split()
    numbers = [value for value in map(number, words) if value is not None]
    if len(numbers) != len(words) or len(words) not in {2, 3} or not Pose(*numbers).is_finite:
        goal.fail(f"x, y and yaw were expected, not {goal.text.strip()!r}")
    gathered.add_node(Node(name, Pose(*numbers)), node.fail)
    for connection in connections:
        if connection.tag != "Connection":
            connection.fail(f"<Connection> was expected, not <{connection.tag}>")
        target = connection.text.strip()
        if not target:
            connection.fail("the connection names no place that it leads to")
        gathered.add_edge(Edge(name, target, connection.attribute("label")), connection.fail)
