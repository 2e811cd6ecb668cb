"""The files of a floor, as the verbs of ``mdm map`` take them."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.usage import UsageError

if TYPE_CHECKING:
    from mdm.maps.files.load import Parts

__all__ = ["add_floor", "check_one_floor", "inputs", "load", "metres", "settle"]


def add_floor(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for the files of a floor; a graph without labels comes as the labels, see `settle`."""
    parser.add_argument(
        "map",
        metavar="MAP.yaml",
        help="ROS's map.yaml, whose image is a PGM, PNG or BMP; or a building.toml, alone, which names several floors",
    )
    parser.add_argument(
        "labels",
        metavar="LABELS.png",
        nargs="?",
        help="an image of the same size, with a colour for each place; without, the zones of the graph are its places",
    )
    parser.add_argument(
        "graph",
        metavar="GRAPH",
        nargs="?",
        help="the original's TopologicalMap (XML), LCAS's tmap2 (YAML), or Nav2's route graph (GeoJSON)",
    )
    parser.add_argument(
        "--names",
        metavar="FILE",
        help="predicate_labels.yaml, the colours of places; by default those under their goals",
    )
    parser.add_argument(
        "--reach", metavar="M", type=metres, help="how far from its goal a place without zone reaches, in metres"
    )


def settle(arguments: argparse.Namespace, *, graph_needed: bool = True) -> bool:
    """Let what is given alone beside the map be the graph; return whether it is a building's file instead of a map.

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
    from mdm.maps.files.load import load_parts  # noqa: PLC0415 - `mdm --help` needs no numpy

    return load_parts(
        arguments.graph, grid=arguments.map, labels=arguments.labels, names=arguments.names, reach=arguments.reach
    )


def inputs(arguments: argparse.Namespace) -> list[str]:
    """Return the files that are read of a floor, the image of the map too, none of which may be written."""
    from mdm.maps.files.occupancy import image_of  # noqa: PLC0415 - `mdm --help` needs no numpy

    given = (arguments.map, *(getattr(arguments, name, None) for name in ("labels", "graph", "names")))
    return [path for path in given if path is not None] + [str(image_of(arguments.map))]


def metres(text: str) -> float:
    """Parse an argument as a number of metres of 0 or more."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"a number of metres, 0 or more, was expected, not {text!r}")
    return number
