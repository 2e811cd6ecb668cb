"""``mdm team run``: run one agent of a team, as ``mdm run FILE --agent NAME`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.cli.robots.run import run as run_alone
from mdm.cli.team.file import forget_state, team_of
from mdm.cli.team.up import check_ports

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Run the agent; return the exit status."""
    team = team_of(arguments.file)
    if arguments.fresh and arguments.agent in team.names:
        check_ports([team.agents[team.names.index(arguments.agent)]])  # one that lives there remembers
        forget_state(arguments.file, [arguments.agent])
    return run_alone(arguments)
