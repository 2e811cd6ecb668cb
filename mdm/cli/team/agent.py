"""``mdm team run``: run one agent of a team, as ``mdm run FILE --agent NAME`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.cli.robots.run import run as run_alone
from mdm.cli.team.file import team_of

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Run the agent; return the exit status."""
    team_of(arguments.file)
    return run_alone(arguments)
