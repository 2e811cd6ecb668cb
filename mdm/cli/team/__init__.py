"""``mdm team``: run a team, and ask it how it is."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import complete

if TYPE_CHECKING:
    import argparse

__all__ = ["VERBS", "add_parser", "run"]

VERBS = {
    "up": "mdm.cli.team.up",
    "run": "mdm.cli.team.agent",
    "status": "mdm.cli.team.status",
    "start": "mdm.cli.team.commands",
    "stop": "mdm.cli.team.commands",
    "reset": "mdm.cli.team.commands",
    "release": "mdm.cli.team.commands",
    "check": "mdm.cli.team.check",
    "decisions": "mdm.cli.team.decisions",
    "certificates": "mdm.cli.team.certificates",
}


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb, its own verbs and their arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "team",
        help="run a team, and ask it how it is",
        description="Run the agents of a team's TOML file, one process per agent, and ask them how they are.",
        epilog="example: mdm team up examples/team/meeting.toml --seconds 20",
    )
    kinds = parser.add_subparsers(dest="team_verb", metavar="VERB", required=True)
    for name, module in VERBS.items():
        kind: argparse.ArgumentParser = importlib.import_module(module).add_parser(kinds, name)
        complete(kind, f"team {name}")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the verb; return the exit status."""
    return int(importlib.import_module(VERBS[arguments.team_verb]).run(arguments))
