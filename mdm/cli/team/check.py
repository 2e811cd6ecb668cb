"""``mdm team check``: everything that ``mdm team run`` would refuse, at every agent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.files.check import report
from mdm.cli.files.oddities import oddities
from mdm.cli.robots.ensembles import load_ensembles
from mdm.cli.team.file import systems_of, team_agents_of
from mdm.config import load_team, load_team_file
from mdm.errors import ConfigError, Error
from mdm.logic import similar
from mdm.team import Team
from mdm.team.transport.access import OPERATOR, ROUTER, WARNING, days_left, ending
from mdm.team.transport.session import import_zenoh
from mdm.team.transport.settings import address, exposed

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from mdm.cli.files.check import Findings
    from mdm.config.team_file import TeamFile
    from mdm.models import MDP


def run(arguments: argparse.Namespace) -> int:
    """Check the file; return the exit status."""

    def examined() -> Findings:
        try:
            return examine(arguments.file, team_agents_of(arguments.file), imports=arguments.imports)
        except ConfigError as error:
            return None, [str(problem) for problem in error.problems], []

    return report(arguments.file, examined, json=arguments.json, command="mdm team check")


def examine(file: str, agents: Sequence[str], *, imports: bool) -> Findings:
    """Return the content of a team's file in words, its problems, and notes on oddities."""
    models: dict[Path, MDP] = {}  # the same at all agents
    systems, problems = systems_of(agents, lambda agent: load_ensembles(file, agent, imports=imports, models=models))
    ensembles = [ensemble for system in systems.values() for ensemble in system.ensembles.values()]
    own = [note for ensemble in ensembles for note in ensemble.notes()]
    notes = [*dict.fromkeys(own if problems else oddities(file, ensembles, imports=imports))]
    try:
        import_zenoh()
    except Error as error:
        problems.append(str(error))
    try:
        described = load_team_file(file)
    except ConfigError:  # which each agent has told
        return None, problems, notes
    if described is None:
        raise AssertionError
    team = described.team
    found = {name: days_left(described.access(name)) for name in (*agents, OPERATOR, ROUTER)}
    days = {name: left for name, left in found.items() if left is not None}
    valid = f", with certificates for {min(days.values()):.1f} days" if days else ""
    soon = [ending(left, name) for name, left in days.items() if left < WARNING]
    return (
        f"team {team.name!r} of {len(agents)} agents ({', '.join(agents)}){valid}",
        problems,
        [
            *notes,
            *_reaching(described),
            *_beside(Path(file), team),
            *soon,
        ],
    )


def _beside(file: Path, team: Team) -> Iterator[str]:
    """Yield how other files of the team, in the same folder, differ from this one."""
    for path in sorted(file.parent.glob("*.toml")):
        try:
            other = None if path.samefile(file) else load_team(path)
        except (Error, OSError):  # which that file's own check tells
            continue
        if other is None or not _is_same(team, other):
            continue
        told = f"agents of this file and of {path.name}"
        if other.name != team.name:
            yield f"{told} never meet: their team is {team.name!r} here, and {other.name!r} there"
        if other.names != team.names:
            yield f"{told} never decide together: {', '.join(team.names)} here, and {', '.join(other.names)} there"
        theirs = [] if other.router or team.router else list(other.endpoints().items())
        for name, end in team.endpoints().items():
            for one, there in theirs:
                if one == name and address(end) != address(there):
                    yield f"{told} look for {name!r} at different addresses: {end} here, and {there} there"
                elif one != name and address(end) == address(there):
                    yield f"{told} look for different agents at {end}: {name!r} here, and {one!r} there"


def _is_same(team: Team, other: Team) -> bool:
    """Return whether two files seem to be of one team: it has one name, or a mistyped one, or the same addresses."""
    ends, theirs, usual = ({*one.endpoints().values()} for one in (team, other, Team("team", team.names)))
    named = {*team.names} == {*other.names} and (similar(team.name, [other.name]) or (ends & theirs) - usual)
    return team.name == other.name or bool(named)


def _reaching(described: TeamFile) -> Iterator[str]:
    """Yield oddities of how the agents reach each other, and who else may."""
    team = described.team
    ends = team.endpoints()
    here = [name for name, endpoint in ends.items() if "/127.0.0.1:" in endpoint or "/localhost:" in endpoint]
    if 0 < len(here) < len(ends):
        yield (
            f"{', '.join(here)} can be reached from {'its' if len(here) == 1 else 'their'} own machine alone, and the "
            "other agents have endpoints elsewhere"
        )
    listens = [agent.listens or team.router or "" for agent in team.agents]
    if described.access(team.names[0]) is None and (risk := exposed(dict.fromkeys(listens))) is not None:
        yield risk
