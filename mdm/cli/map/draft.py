"""``mdm map goals`` and ``mdm map draft``: a proposal for the graph of a floor, and a draft of its labels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.map.floor import check_one_floor, check_output, floor_picture, inputs, keep, kinds
from mdm.cli.report import as_json, columns
from mdm.errors import Error
from mdm.formats.target import check_place
from mdm.maps import draft, load_graph, load_grid, propose, save_graph, save_labels
from mdm.maps.files.load import Parts
from mdm.maps.paths import passages, route_sentence, undivided, widest

if TYPE_CHECKING:
    import argparse


def goals(arguments: argparse.Namespace) -> int:
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
        keep(floor_picture(parts, arguments.radius, coordinates=True), arguments.picture)
    cell, places, rows = labels.frame.resolution**2, [], [("place", "free", "goal", "ways to")]
    for node in graph.nodes:
        area, (x, y) = float((labels.cells(node.name) & grid.free).sum()) * cell, (node.goal.x, node.goal.y)
        ways = [edge.target for edge in graph.edges if edge.source == node.name]
        places.append({"name": node.name, "area": area, "goal": [x, y], "ways": ways})
        rows.append((node.name, f"{area:.1f} m²", f"({x:.2f}, {y:.2f})", ", ".join(ways) or "none"))
    left_out = float((grid.free & (labels.raster == 0)).sum()) * cell
    if arguments.json:
        print(as_json({"graph": arguments.output, "places": places, "left_out": left_out}))
        return 0
    print("\n".join(columns(rows, {1})))
    if left_out >= 1:
        print(f"\nnote: {left_out:.1f} m² are left out, which the robot cannot reach")
    if len(places) == 1:
        print("\nnote: nothing divides this floor: add places by hand; mdm map show MAP.yaml -o PNG has coordinates")
    print(f"\n{arguments.output}: a proposal; correct it in an editor, then mdm map draft")
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Draft the labels; return the exit status."""
    check_one_floor(arguments)
    check_output(arguments.output, *inputs(arguments))
    graph, grid = load_graph(arguments.graph, robot=kinds(arguments)), load_grid(arguments.map)
    labels = draft(grid, graph)
    found = passages(labels, grid)
    doors = {pair: passage.width for pair, passage in widest(found).items()}
    ways = {frozenset((edge.source, edge.target)): None for edge in graph.edges if edge.source != edge.target}
    places, rows = [], [("place", "cells", "area", "neighbours")]
    for name in graph.names:
        cells = int(labels.cells(name).sum())
        area = cells * labels.frame.resolution**2
        near = {other: doors[pair] for other in graph.names if (pair := frozenset((name, other))) in doors}
        neighbours = [{"name": other, "width": width} for other, width in near.items()]
        places.append({"name": name, "cells": cells, "area": area, "neighbours": neighbours})
        told = ", ".join(f"{other} ({width:.2f} m)" for other, width in near.items())
        rows.append((name, f"{cells:,}", f"{area:.1f} m²", told or "none"))
    in_order = {name: index for index, name in enumerate(graph.names)}.__getitem__
    apart = [sorted(pair, key=in_order) for pair in ways if pair not in doors]
    touching = [sorted(pair, key=in_order) for pair in doors if pair not in ways]
    crowded = undivided(labels, grid, found)
    save_labels(labels, arguments.output)
    if arguments.json:
        facts = {"places": places, "apart": apart, "touching": touching, "undivided": crowded}
        print(as_json({"labels": arguments.output, **facts}))
        return 0
    print("\n".join(columns(rows, {1, 2})))
    if apart or touching:
        print()
    for one, other in apart:
        print(f"note: the graph has a way between {one!r} and {other!r}, and in the draft they do not touch")
    if crowded:
        print(f"note: {route_sentence(len(crowded), len(places))}")
    for one, other in touching:
        if not (one in crowded and other in crowded):
            print(f"note: {one!r} and {other!r} touch in the draft, and the graph has no way between them")
    print(f"\n{arguments.output}: a draft; correct it in a paint program, then mdm map check")
    return 0
