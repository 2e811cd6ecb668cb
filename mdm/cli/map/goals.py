"""``mdm map goals``: rooms, goals and ways from a map alone, to be corrected by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.map.drawing import check_output, floor_picture, keep
from mdm.cli.map.floor import check_one_floor, inputs
from mdm.cli.report import as_json
from mdm.errors import Error
from mdm.formats.target import check_place
from mdm.maps import draft, load_grid, propose, save_graph
from mdm.maps.check import RADIUS
from mdm.maps.files.load import Parts

if TYPE_CHECKING:
    import argparse

    from mdm.maps import Graph, Grid, Labels

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Propose the graph; return the exit status."""
    check_one_floor(arguments)
    if Path(arguments.output).suffix.lower() != ".xml":
        raise Error(f"{arguments.output}: the graph is written as a TopologicalMap, in XML: its file ends in .xml")
    check_place(arguments.output, *inputs(arguments))
    if arguments.picture is not None:
        check_output(arguments.picture, arguments.output, *inputs(arguments))
    grid = load_grid(arguments.map)
    given = {name: value for name in ("radius", "margin", "least") if (value := getattr(arguments, name)) is not None}
    graph = propose(grid, **given)
    labels = draft(grid, graph)
    save_graph(graph, arguments.output)
    if arguments.picture is not None:
        parts = Parts(labels, graph, grid, None, ())
        keep(floor_picture(parts, given.get("radius", RADIUS), coordinates=True), arguments.picture)
    facts = _facts(labels, grid, graph)
    if arguments.json:
        print(as_json({"graph": arguments.output, **facts}))
    else:
        _tell(facts)
        print(f"\n{arguments.output}: a proposal; correct it in an editor, then mdm map draft")
    return 0


def _facts(labels: Labels, grid: Grid, graph: Graph) -> dict[str, Any]:
    """Return the proposal, ready for JSON."""
    cell = labels.frame.resolution**2
    areas = {name: float((labels.cells(name) & grid.free).sum()) * cell for name in graph.names}
    return {
        "places": [
            {
                "name": node.name,
                "area": areas[node.name],
                "goal": [node.goal.x, node.goal.y],
                "ways": [edge.target for edge in graph.edges if edge.source == node.name],
            }
            for node in graph.nodes
        ],
        "left_out": float((grid.free & (labels.raster == 0)).sum()) * cell,
    }


def _tell(facts: dict[str, Any]) -> None:
    lines = [("place", "free", "goal", "ways to")]
    for place in facts["places"]:
        x, y = place["goal"]
        lines.append(
            (place["name"], f"{place['area']:.1f} m²", f"({x:.2f}, {y:.2f})", ", ".join(place["ways"]) or "none")
        )
    widths = [max(len(line[column]) for line in lines) for column in range(3)]
    for name, area, goal, ways in lines:
        print(f"{name:{widths[0]}}  {area:>{widths[1]}}  {goal:{widths[2]}}  {ways}")
    if facts["left_out"] >= 1:
        print(f"\nnote: {facts['left_out']:.1f} m² are left out, which the robot cannot reach")
    if len(facts["places"]) == 1:
        print("\nnote: nothing divides this floor: add places by hand; mdm map show MAP.yaml -o PNG has coordinates")
