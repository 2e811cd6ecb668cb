"""The team of a file, and its ensembles, as the verbs of ``mdm team`` need them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.usage import UsageError
from mdm.config import load_system, load_team, load_team_file
from mdm.config.builder import agents_of
from mdm.errors import ConfigError
from mdm.runtime import VirtualClock
from mdm.team import Network
from mdm.team.storage import forget
from mdm.team.transport.access import OPERATOR, ROUTER, access_of

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from mdm.config import System
    from mdm.models import MDP
    from mdm.team import Team


def team_of(file: str) -> Team:
    """Return the team that a file describes.

    Raises:
        UsageError: If it describes none.
        ConfigError: If its table ``team`` has problems.
    """
    team = load_team(file)
    if team is None:
        raise _no_team(file)
    return team


def team_agents_of(file: str) -> tuple[str, ...]:
    """Return the names of the agents of a file's team, though the file may have problems.

    Raises:
        UsageError: If it describes no team.
        ConfigError: If it does not say who the agents are.
    """
    agents = agents_of(file)
    if not agents:
        raise _no_team(file)
    return agents


def _no_team(file: str) -> UsageError:
    return UsageError(f"{file} describes no team: a table [team] is missing; `mdm run {file}` runs it alone")


def systems_of(agents: Sequence[str], load: Callable[[str], System]) -> tuple[dict[str, System], list[str]]:
    """Return the system of each agent that can be built, and the problems of all, each told once."""
    systems: dict[str, System] = {}
    at: dict[str, list[str]] = {}
    for agent in agents:
        try:
            systems[agent] = load(agent)
        except ConfigError as error:
            for problem in error.problems:
                at.setdefault(str(problem), []).append(agent)
    told = [text if len(having) == len(agents) else f"{text} (at {', '.join(having)})" for text, having in at.items()]
    return systems, told


def sound_systems_of(file: str, team: Team) -> dict[str, System]:
    """Return each agent's system, whose functions do nothing.

    Raises:
        ConfigError: With all problems of the file.
    """
    nobody = Network(VirtualClock(), team=team.name)
    models: dict[Path, MDP] = {}  # the same at all agents

    def load(agent: str) -> System:
        return load_system(file, agent=agent, callbacks=False, transport=nobody.transport(agent), models=models)

    systems, problems = systems_of(team.names, load)
    if problems:
        raise ConfigError("\n".join(problems))
    return systems


def forget_state(file: str, agents: Sequence[str]) -> None:
    """Remove the memory that agents have of an earlier process, and print it.

    Raises:
        Error: If it cannot be removed.
    """
    described = load_team_file(file)
    if described is None:
        raise _no_team(file)
    for agent in agents:
        forgotten = forget(described.state, described.team.name, agent)
        if forgotten is not None:
            print(f"mdm team: agent {agent!r} forgets: {forgotten}", file=sys.stderr, flush=True)


def ensembles_of(file: str, team: Team) -> dict[str, list[str]]:
    """Return the agents that run each ensemble of the team, by its name.

    Raises:
        ConfigError: With all problems of the file.
    """
    found: dict[str, list[str]] = {}
    for agent, system in sound_systems_of(file, team).items():
        for name in system.member.ensembles if system.member is not None else ():
            found.setdefault(name, []).append(agent)
    return found


def certificates(arguments: argparse.Namespace) -> int:
    """Write certificates to try a team with; return the exit status."""
    from mdm.team.transport.certificates import make_certificates  # noqa: PLC0415 - for this verb alone

    team = team_of(arguments.file)
    hosts = {agent.name: [] if agent.reached is None else [_host(agent.reached)] for agent in team.agents}
    if team.router is not None:
        hosts[ROUTER] = [_host(team.router)]
    hosts.setdefault(OPERATOR, []).extend(arguments.host)
    kept = [name for name in hosts if Path(access_of(Path(arguments.output), name).certificate).exists()]
    made = [name for name in make_certificates(arguments.output, hosts, days=arguments.days) if name not in kept]
    print(f"{arguments.output}: certificates of an authority and {', '.join(made)}, valid for {arguments.days} days")
    if kept:
        print(f"{arguments.output}: those of {', '.join(kept)} stay as they are")
    return 0


def _host(endpoint: str) -> str:
    """Return the host of an endpoint such as ``tls/robot1.local:7447``."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
