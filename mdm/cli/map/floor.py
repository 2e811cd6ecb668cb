"""The files of a floor, as the verbs of ``mdm map`` take them."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mdm.maps.files.load import Parts

__all__ = ["add_floor", "inputs", "load", "metres"]


def add_floor(parser: argparse.ArgumentParser, *, graph_needed: bool = True) -> None:
    """Add the arguments for the files of a floor; a graph that is not needed comes as the labels if alone."""
    parser.add_argument("map", metavar="MAP.yaml", help="ROS's map.yaml, whose image is a PGM, PNG or BMP")
    parser.add_argument(
        "labels",
        metavar="LABELS.png",
        nargs="?",
        help="an image of the same size, with a colour for each place; without, the zones of the graph are its places",
    )
    parser.add_argument(
        "graph",
        metavar="GRAPH",
        nargs=None if graph_needed else "?",
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


def load(arguments: argparse.Namespace) -> Parts:
    """Load the files of a floor."""
    from mdm.maps.files.load import load_parts  # noqa: PLC0415 - `mdm --help` needs no numpy

    return load_parts(
        arguments.graph, grid=arguments.map, labels=arguments.labels, names=arguments.names, reach=arguments.reach
    )


def inputs(arguments: argparse.Namespace) -> list[str]:
    """Return the files that are read, the image of the map too, none of which may be written."""
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
