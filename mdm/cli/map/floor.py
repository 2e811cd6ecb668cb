"""The files of a floor, as the verbs of ``mdm map`` take them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.usage import UsageError
from mdm.maps.files.load import load_parts
from mdm.maps.files.occupancy import image_of

if TYPE_CHECKING:
    import argparse

    from mdm.maps.files.load import Parts

__all__ = ["check_one_floor", "inputs", "kinds", "load", "settle"]


def settle(arguments: argparse.Namespace, *, graph_needed: bool = True) -> bool:
    """Take a single file beside the map as the graph; return whether the map is a building's file instead.

    Raises:
        UsageError: If there is no graph and one is needed, or there is more than a building's file.
    """
    if Path(arguments.map).suffix.lower() == ".toml":
        given = [name for name in ("labels", "graph", "names", "reach") if getattr(arguments, name) is not None]
        if given:
            raise UsageError(f"{arguments.map}: a building's file names maps, graphs and labels itself: give it alone")
        return True
    if arguments.graph is None:
        arguments.labels, arguments.graph = None, arguments.labels
    if arguments.graph is None and graph_needed:
        raise UsageError("the following arguments are required: GRAPH")
    return False


def check_one_floor(arguments: argparse.Namespace) -> None:
    """Refuse a building's file where a map is needed.

    Raises:
        UsageError: If it is one.
    """
    if Path(arguments.map).suffix.lower() == ".toml":
        raise UsageError(f"{arguments.map}: this is of a whole building: give the map of one floor, each in its turn")


def load(arguments: argparse.Namespace) -> Parts:
    """Load the files of a floor."""
    return load_parts(
        arguments.graph,
        grid=arguments.map,
        labels=arguments.labels,
        names=arguments.names,
        reach=arguments.reach,
        robot=kinds(arguments),
    )


def kinds(arguments: argparse.Namespace) -> dict[str, str]:
    """Return what the robot is, by kinds."""
    return {kind: value for kind, _, value in (each.partition("=") for each in arguments.kinds) if value}


def inputs(arguments: argparse.Namespace) -> list[str]:
    """Return the files that are read of a floor, the image of the map too, none of which may be written."""
    given = (arguments.map, *(getattr(arguments, name, None) for name in ("labels", "graph", "names")))
    return [path for path in given if path is not None] + [str(image_of(arguments.map))]
