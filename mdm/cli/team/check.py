"""``mdm team check``: everything that ``mdm team run`` would refuse, at every agent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.usage import add_import

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from mdm.cli.files.check import Findings
    from mdm.models import MDP
    from mdm.team import Team

__all__ = ["add_parser", "examine", "run"]


def add_parser(verbs: Any, name: str) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help="list everything that keeps an agent from running",
        description=(
            "List everything that `mdm team run` would refuse, at every agent. Functions are looked for in the source "
            "of their modules, which are not run, unless --import is given."
        ),
        epilog="example: mdm team check examples/team/meeting.toml",
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    add_import(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Check the file; return the exit status."""
    from mdm.cli.files.check import report  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.cli.team.file import team_of  # noqa: PLC0415
    from mdm.errors import ConfigError  # noqa: PLC0415

    def examined() -> Findings:
        try:
            return examine(arguments.file, team_of(arguments.file), imports=arguments.imports)
        except ConfigError as error:
            return None, [str(problem) for problem in error.problems], []

    return report(arguments.file, examined, json=arguments.json, command="mdm team check")


def examine(file: str, team: Team, *, imports: bool) -> Findings:
    """Return what a team's file holds in words, its problems, and notes on oddities.

    Args:
        file: The file.
        team: Its team.
        imports: Whether functions are imported.
    """
    from mdm.cli.policies.inputs import load_ensembles  # noqa: PLC0415
    from mdm.cli.team.file import check_zenoh, systems_of  # noqa: PLC0415
    from mdm.config import load_team_file  # noqa: PLC0415
    from mdm.errors import Error  # noqa: PLC0415
    from mdm.team.transport.settings import exposed  # noqa: PLC0415

    models: dict[Path, MDP] = {}  # the same at all agents
    systems, problems = systems_of(team, lambda agent: load_ensembles(file, agent, imports=imports, models=models))
    notes = dict.fromkeys(
        note for system in systems.values() for ensemble in system.ensembles.values() for note in ensemble.notes()
    )
    told = [*notes]
    try:
        check_zenoh()
    except Error as error:
        problems.append(str(error))
    ends = {agent.name: agent.endpoint or "" for agent in team.agents}
    here = [name for name, endpoint in ends.items() if "/127.0.0.1:" in endpoint or "/localhost:" in endpoint]
    if 0 < len(here) < len(ends):
        told.append(
            f"{', '.join(here)} can be reached from {'its' if len(here) == 1 else 'their'} own machine alone, and the "
            "other agents have endpoints elsewhere"
        )
    described = load_team_file(file)
    if described is not None and described.access(team.names[0]) is None:
        risk = exposed(ends.values())
        told += [] if risk is None else [risk]
    return f"team {team.name!r} of {len(team.names)} agents ({', '.join(team.names)})", problems, told
