"""``mdm team run``: run one agent of a team, as ``mdm run FILE --agent NAME`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.robots.run import add_arguments, run as run_alone

if TYPE_CHECKING:
    import argparse

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any, name: str) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help="run one agent in this process",
        description="Run one agent of a team until Ctrl-C, SIGTERM, --seconds, or --epochs of its decisions.",
        epilog="example: mdm team run examples/team/meeting.toml --agent ada",
    )
    add_arguments(parser, virtual=False)
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the agent; return the exit status."""
    from mdm.cli.team.file import team_of  # noqa: PLC0415 - `mdm --help` needs no numpy

    team_of(arguments.file)
    return run_alone(arguments)
