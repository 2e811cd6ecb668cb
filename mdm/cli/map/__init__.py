"""``mdm map``: propose, draft, check and show the map of a floor, and make a model from it."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import complete

if TYPE_CHECKING:
    import argparse

__all__ = ["VERBS", "add_parser", "run"]

VERBS = ("goals", "draft", "check", "show", "model")


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb, its own verbs and their arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "map",
        help="propose, draft, check and show the map of a floor, and make a model from it",
        description=(
            "Propose, draft, check and show the map of a floor: its grid, the labels of its places, their graph; and "
            "make a model from it, which mdm solve takes."
        ),
        epilog="example: mdm map show map.yaml labels.png graph.xml -o floor.png",
    )
    kinds = parser.add_subparsers(dest="map_verb", metavar="VERB", required=True)
    for name in VERBS:
        kind: argparse.ArgumentParser = importlib.import_module(f"mdm.cli.map.{name}").add_parser(kinds)
        complete(kind, f"map {name}")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the verb; return the exit status."""
    return int(importlib.import_module(f"mdm.cli.map.{arguments.map_verb}").run(arguments))
