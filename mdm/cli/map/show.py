"""``mdm map show``: the map of a floor as a table and as a picture."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

from mdm.cli.map.floor import (
    building_picture,
    check_output,
    floor_picture,
    grid_picture,
    inputs,
    keep,
    kinds,
    load,
    settle,
)
from mdm.cli.report import as_json, columns
from mdm.cli.usage import UsageError
from mdm.maps import load_grid
from mdm.maps.files.building import load_building
from mdm.maps.paths import passages, widest

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from mdm.maps import Frame
    from mdm.maps.files.building import BuildingParts
    from mdm.maps.files.load import Parts

_TOLD = 5
"""Widths of passages between two places that are told one by one."""


def run(arguments: argparse.Namespace) -> int:
    """Show the map; return the exit status."""
    building = load_building(arguments.map, robot=kinds(arguments)) if settle(arguments, graph_needed=False) else None
    if arguments.output is not None:
        check_output(arguments.output, *(inputs(arguments) if building is None else map(str, building.files)))
    if building is None and arguments.graph is None:
        picture = _show_grid(arguments)
    elif building is None:
        parts = load(arguments)
        facts = _facts(parts, 2 * (arguments.radius or 0.0))
        if arguments.json:
            print(as_json(facts))
        else:
            _tell(facts, parts)
        picture = partial(floor_picture, parts, arguments.radius, coordinates=arguments.coordinates)
    else:
        _show_building(building, arguments)
        picture = partial(building_picture, building, arguments.radius, coordinates=arguments.coordinates)
    if arguments.output is not None:
        keep(picture(), arguments.output)
        if not arguments.json:
            print(f"{arguments.output}: drawn")
    return 0


def _show_building(building: BuildingParts, arguments: argparse.Namespace) -> None:
    floors = {name: _facts(parts, 2 * (arguments.radius or 0.0)) for name, parts in building.floors.items()}
    if arguments.json:
        lifts = [
            {key: getattr(lift, key) for key in ("name", "stops", "seconds", "one_way")} for lift in building.lifts
        ]
        print(as_json({"floors": floors, "lifts": lifts, "start": building.start}))
        return
    for name, facts in floors.items():
        print(f"floor {name}")
        _tell(facts, building.floors[name])
        print()
    print("lifts" if building.lifts else "no lifts")
    for lift in building.lifts:
        way = " -> " if lift.one_way else " - "
        print(f"  {lift.name}: {way.join(lift.stops)}, {lift.seconds:g} s from one to the next")
    if building.start is not None:
        print(f"the robot starts in {building.start}")


def _show_grid(arguments: argparse.Namespace) -> Callable[[], Any]:
    """Show a map without places; return a function that draws it."""
    for option in ("names", "reach", "radius"):
        if getattr(arguments, option) is not None:
            raise UsageError(f"--{option} is for the places of a graph, and there is none")
    grid = load_grid(arguments.map)
    cell = grid.frame.resolution**2
    facts = _facts_of_frame(grid.frame) | {
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
    return partial(grid_picture, grid)


def _facts_of_frame(frame: Frame) -> dict[str, Any]:
    origin = [frame.x, frame.y, frame.yaw]
    return {"cells": list(frame.shape), "resolution": frame.resolution, "origin": origin}


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
    wide = [{"between": list(passage.places), "width": passage.width} for passage in found if passage.width >= narrow]
    return {**_facts_of_frame(labels.frame), "places": places, "passages": wide}


def _tell_frame(facts: dict[str, Any]) -> None:
    rows, columns = facts["cells"]
    x, y, yaw = facts["origin"]
    turned = f", turned by {math.degrees(yaw):.1f}°" if yaw else ""
    print(f"{columns} x {rows} cells of {facts['resolution']:g} m, the lower left corner at ({x:g}, {y:g}){turned}")


def _tell(facts: dict[str, Any], parts: Parts) -> None:
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
    print("\n".join(columns(lines, {1})))
    if facts["passages"]:
        print("\npassages")
        widths_of: dict[tuple[str, ...], list[str]] = {}
        for passage in facts["passages"]:
            widths_of.setdefault(tuple(passage["between"]), []).append(f"{passage['width']:.2f}")
        for pair, all_widths in widths_of.items():
            more = f" and {len(all_widths) - _TOLD} more" if len(all_widths) > _TOLD else ""
            print(f"  {' - '.join(pair)}: {', '.join(all_widths[:_TOLD])} m{more}")
    for problem in parts.problems:
        print(f"note: {problem.text}")


def _wide(width: float | None) -> str:
    return "" if width is None else f" ({width:.2f} m)"
