"""``mdm map draft``: an image of labels from a map and one goal in each place, to be corrected by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.map.drawing import check_output
from mdm.cli.map.floor import check_one_floor, inputs, kinds
from mdm.cli.report import as_json
from mdm.maps import draft, load_graph, load_grid, save_labels
from mdm.maps.paths import passages, route_sentence, undivided, widest

if TYPE_CHECKING:
    import argparse

    from mdm.maps import Graph, Grid, Labels

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Draft the labels; return the exit status."""
    check_one_floor(arguments)
    check_output(arguments.output, *inputs(arguments))
    graph, grid = load_graph(arguments.graph, robot=kinds(arguments)), load_grid(arguments.map)
    labels = draft(grid, graph)
    facts = _facts(labels, grid, graph)
    save_labels(labels, arguments.output)
    if arguments.json:
        print(as_json({"labels": arguments.output, **facts}))
    else:
        _tell(facts)
        print(f"\n{arguments.output}: a draft; correct it in a paint program, then mdm map check")
    return 0


def _facts(labels: Labels, grid: Grid, graph: Graph) -> dict[str, Any]:
    """Return the draft, ready for JSON."""
    found = passages(labels, grid)
    doors = {pair: passage.width for pair, passage in widest(found).items()}
    ways = {frozenset((edge.source, edge.target)): None for edge in graph.edges if edge.source != edge.target}
    places = []
    for name in graph.names:
        cells = int(labels.cells(name).sum())
        near = [
            {"name": other, "width": doors[pair]}
            for other in graph.names
            if (pair := frozenset((name, other))) in doors
        ]
        places.append({"name": name, "cells": cells, "area": cells * labels.frame.resolution**2, "neighbours": near})
    in_order = {name: index for index, name in enumerate(graph.names)}.__getitem__
    return {
        "places": places,
        "apart": [sorted(pair, key=in_order) for pair in ways if pair not in doors],
        "touching": [sorted(pair, key=in_order) for pair in doors if pair not in ways],
        "undivided": undivided(labels, grid, found),
    }


def _tell(facts: dict[str, Any]) -> None:
    lines = [("place", "cells", "area", "neighbours")]
    for place in facts["places"]:
        near = ", ".join(f"{other['name']} ({other['width']:.2f} m)" for other in place["neighbours"])
        lines.append((place["name"], f"{place['cells']:,}", f"{place['area']:.1f} m²", near or "none"))
    widths = [max(len(line[column]) for line in lines) for column in range(3)]
    for name, cells, area, near in lines:
        print(f"{name:{widths[0]}}  {cells:>{widths[1]}}  {area:>{widths[2]}}  {near}")
    if facts["apart"] or facts["touching"]:
        print()
    for one, other in facts["apart"]:
        print(f"note: the graph has a way between {one!r} and {other!r}, and in the draft they do not touch")
    crowded = facts["undivided"]
    if crowded:
        print(f"note: {route_sentence(len(crowded), len(facts['places']))}")
    for one, other in facts["touching"]:
        if one in crowded and other in crowded:
            continue
        print(f"note: {one!r} and {other!r} touch in the draft, and the graph has no way between them")
