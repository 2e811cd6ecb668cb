"""``mdm team check``: everything that ``mdm team run`` would refuse, at every agent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.cli.files.check import report
from mdm.cli.robots.ensembles import load_ensembles
from mdm.cli.team.file import check_zenoh, systems_of, team_agents_of
from mdm.config import load_team_file
from mdm.errors import ConfigError, Error
from mdm.team.transport.settings import exposed

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from mdm.cli.files.check import Findings
    from mdm.config.team_file import TeamFile
    from mdm.models import MDP

__all__ = ["examine", "run"]


def run(arguments: argparse.Namespace) -> int:
    """Check the file; return the exit status."""

    def examined() -> Findings:
        try:
            return examine(arguments.file, team_agents_of(arguments.file), imports=arguments.imports)
        except ConfigError as error:
            return None, [str(problem) for problem in error.problems], []

    return report(arguments.file, examined, json=arguments.json, command="mdm team check")


def examine(file: str, agents: Sequence[str], *, imports: bool) -> Findings:
    """Return the content of a team's file in words, its problems, and notes on oddities.

    Args:
        file: The file.
        agents: Its team's agents.
        imports: Whether functions are imported.
    """
    models: dict[Path, MDP] = {}  # the same at all agents
    systems, problems = systems_of(agents, lambda agent: load_ensembles(file, agent, imports=imports, models=models))
    notes = dict.fromkeys(
        note for system in systems.values() for ensemble in system.ensembles.values() for note in ensemble.notes()
    )
    try:
        check_zenoh()
    except Error as error:
        problems.append(str(error))
    try:
        described = load_team_file(file)
    except ConfigError:  # which each agent has told
        return None, problems, [*notes]
    if described is None:
        raise AssertionError
    return (
        f"team {described.team.name!r} of {len(agents)} agents ({', '.join(agents)})",
        problems,
        [*notes, *_reaching(described)],
    )


def _reaching(described: TeamFile) -> Iterator[str]:
    """Yield what is odd about how the agents reach each other, and who else may."""
    ends = {agent.name: agent.endpoint or "" for agent in described.team.agents}
    here = [name for name, endpoint in ends.items() if "/127.0.0.1:" in endpoint or "/localhost:" in endpoint]
    if 0 < len(here) < len(ends):
        yield (
            f"{', '.join(here)} can be reached from {'its' if len(here) == 1 else 'their'} own machine alone, and the "
            "other agents have endpoints elsewhere"
        )
    if described.access(described.team.names[0]) is None and (risk := exposed(ends.values())) is not None:
        yield risk
