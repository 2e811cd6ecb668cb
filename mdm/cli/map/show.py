"""``mdm map show``: the map of a floor as a table and as a picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from mdm.cli.map.drawing import building_picture, check_output, floor_picture, grid_picture, keep
from mdm.cli.map.floor import inputs, kinds, load, settle
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError
from mdm.maps import load_grid
from mdm.maps.check import RADIUS
from mdm.maps.files.building import load_building
from mdm.maps.paths import passages, widest

if TYPE_CHECKING:
    import argparse

    from mdm.maps.files.load import Parts

__all__ = ["run"]

_TOLD = 5
"""Widths of passages between two places that are told one by one."""


def run(arguments: argparse.Namespace) -> int:
    """Show the map; return the exit status."""
    if settle(arguments, graph_needed=False):
        return _show_building(arguments)
    if arguments.output is not None:
        check_output(arguments.output, *inputs(arguments))
    if arguments.graph is None:
        return _show_grid(arguments)
    parts = load(arguments)
    facts = _facts(parts, 2 * (arguments.radius or 0.0))
    if arguments.json:
        print(as_json(facts))
    else:
        _tell(facts)
        for problem in parts.problems:
            print(f"note: {problem.text}")
    if arguments.output is not None:
        radius = RADIUS if arguments.radius is None else arguments.radius
        keep(floor_picture(parts, radius, coordinates=arguments.coordinates), arguments.output)
        if not arguments.json:
            print(f"{arguments.output}: drawn")
    return 0


def _show_building(arguments: argparse.Namespace) -> int:
    """Show the floors of a building; return the exit status."""
    building = load_building(arguments.map, robot=kinds(arguments))
    if arguments.output is not None:
        check_output(arguments.output, *map(str, building.files))
    floors = {name: _facts(parts, 2 * (arguments.radius or 0.0)) for name, parts in building.floors.items()}
    lifts = [
        {"name": lift.name, "stops": lift.stops, "seconds": lift.seconds, "one_way": lift.one_way}
        for lift in building.lifts
    ]
    if arguments.json:
        print(as_json({"floors": floors, "lifts": lifts, "start": building.start}))
    else:
        for name, facts in floors.items():
            print(f"floor {name}")
            _tell(facts)
            for problem in building.floors[name].problems:
                print(f"note: {problem.text}")
            print()
        print("lifts" if lifts else "no lifts")
        for lift in building.lifts:
            way = " -> " if lift.one_way else " - "
            print(f"  {lift.name}: {way.join(lift.stops)}, {lift.seconds:g} s from one to the next")
        if building.start is not None:
            print(f"the robot starts in {building.start}")
    if arguments.output is not None:
        radius = RADIUS if arguments.radius is None else arguments.radius
        keep(building_picture(building, radius, coordinates=arguments.coordinates), arguments.output)
        if not arguments.json:
            print(f"{arguments.output}: drawn")
    return 0


def _show_grid(arguments: argparse.Namespace) -> int:
    """Show a map without places; return the exit status."""
    for option in ("names", "reach", "radius"):
        if getattr(arguments, option) is not None:
            raise UsageError(f"--{option} is for the places of a graph, and there is none")
    grid = load_grid(arguments.map)
    frame, cell = grid.frame, grid.frame.resolution**2
    facts = {
        "cells": list(frame.shape),
        "resolution": frame.resolution,
        "origin": [frame.x, frame.y, frame.yaw],
        "free": float(grid.free.sum()) * cell,
        "occupied": float(grid.occupied.sum()) * cell,
        "unknown": float((~grid.free & ~grid.occupied).sum()) * cell,
    }
    if arguments.json:
        print(as_json(facts))
    else:
        _tell_frame(facts)
        print(f"{facts['free']:.1f} m² free, {facts['occupied']:.1f} m² occupied, {facts['unknown']:.1f} m² unknown")
        if arguments.output is None:
            print("\nnote: with -o PNG it is drawn with its coordinates; mdm map goals proposes rooms and goals")
    if arguments.output is not None:
        keep(grid_picture(grid), arguments.output)
        if not arguments.json:
            print(f"{arguments.output}: drawn")
    return 0


def _facts(parts: Parts, narrow: float) -> dict[str, Any]:
    """Return the content of the map, ready for JSON."""
    labels, graph, grid = parts.labels, parts.graph, parts.grid
    found = () if grid is None else passages(labels, grid)
    doors = widest(tuple(passage for passage in found if passage.width >= narrow))
    places = []
    for node in graph.nodes:
        there = node.name in labels.names
        own = labels.cells(node.name) if there else None
        free = own if own is None or grid is None else own & grid.free
        ways = []
        for edge in graph.edges:
            if edge.source == node.name:
                door = doors.get(frozenset((edge.source, edge.target)))
                ways.append({"label": edge.label, "to": edge.target, "width": None if door is None else door.width})
        places.append(
            {
                "name": node.name,
                "area": None if free is None else float(free.sum()) * labels.frame.resolution**2,
                "goal": [node.goal.x, node.goal.y, node.goal.yaw],
                "ways": ways,
            }
        )
    return {
        "cells": list(labels.frame.shape),
        "resolution": labels.frame.resolution,
        "origin": [labels.frame.x, labels.frame.y, labels.frame.yaw],
        "places": places,
        "passages": [{"between": list(pair.places), "width": pair.width} for pair in found if pair.width >= narrow],
    }


def _tell_frame(facts: dict[str, Any]) -> None:
    rows, columns = facts["cells"]
    x, y, yaw = facts["origin"]
    turned = f", turned by {math.degrees(yaw):.1f}°" if yaw else ""
    print(f"{columns} x {rows} cells of {facts['resolution']:g} m, the lower left corner at ({x:g}, {y:g}){turned}")


def _tell(facts: dict[str, Any]) -> None:
    _tell_frame(facts)
    print()
    lines = [("place", "free", "goal", "ways")]
    for place in facts["places"]:
        area = "-" if place["area"] is None else f"{place['area']:.1f} m²"
        x, y, yaw = place["goal"]
        ways = ", ".join(
            f"{way['label']}{'' if way['label'] == 'to ' + way['to'] else ': ' + way['to']}{_wide(way['width'])}"
            for way in place["ways"]
        )
        lines.append((place["name"], area, f"({x:.2f}, {y:.2f}, {math.degrees(yaw):.0f}°)", ways or "none"))
    widths = [max(len(line[column]) for line in lines) for column in range(3)]
    for name, area, goal, ways in lines:
        print(f"{name:{widths[0]}}  {area:>{widths[1]}}  {goal:{widths[2]}}  {ways}")
    if facts["passages"]:
        print("\npassages")
        widths_of: dict[tuple[str, ...], list[str]] = {}
        for passage in facts["passages"]:
            widths_of.setdefault(tuple(passage["between"]), []).append(f"{passage['width']:.2f}")
        for pair, all_widths in widths_of.items():
            more = f" and {len(all_widths) - _TOLD} more" if len(all_widths) > _TOLD else ""
            print(f"  {' - '.join(pair)}: {', '.join(all_widths[:_TOLD])} m{more}")


def _wide(width: float | None) -> str:
    return "" if width is None else f" ({width:.2f} m)"
