"""The team of a file, from its table ``team``."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta

from mdm.config.communication import read_communication
from mdm.config.tables import Seconds, Table, stated
from mdm.errors import ConfigError
from mdm.team.team import FIRST_PORT, Agent, Mode, Quorum, Team
from mdm.team.transport.access import Access, access_of
from mdm.team.transport.allowance import Allowance
from mdm.team.transport.ceilings import Ceiling
from mdm.team.transport.transport import Priority

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.config.functions import Functions
    from mdm.config.problems import Problems

__all__ = ["AllowanceTable", "CeilingTable", "TeamFile", "TeamTable", "read_team"]


class AgentTable(Table, frozen=True):
    """An agent of a team; short form: its name.

    Attributes:
        name: Its name, the same in the files of all.
        endpoint: Where the others reach it, such as ``tcp/192.168.0.7:7447``; by default on its own machine alone.
        listen: Where it listens instead, such as ``tcp/0.0.0.0:7447`` in a container.
        connect: Where the others reach it instead.
    """

    name: str
    endpoint: str | None = None
    listen: str | None = None
    connect: str | None = None


class TeamTable(Table, frozen=True):
    """The team that a file is of, see `mdm.Team`; agents are converted separately.

    Attributes:
        port: Agents without an endpoint listen on this machine: the first at this port, the second at the next one.
        router: The endpoint of a router, through which all agents talk; they then listen nowhere.
        access: A folder with ``authority.pem``, and ``NAME.pem`` and ``NAME.key.pem`` of each agent: mutual TLS.
        allowance: What each agent may send; by default anything.
        state: The folder in which each agent keeps that it was stopped; by default that of the file.
    """

    name: str
    agents: list[Any]
    port: Annotated[int, Meta(ge=1, le=65535)] = FIRST_PORT
    mode: Mode | None = None
    period: Seconds | None = None
    drive: str | float | None = None
    deadline: Seconds | None = None
    quorum: Quorum | None = None
    controller: str | None = None
    lease: Seconds | None = None
    max_age: Seconds | None = None
    memory: Annotated[float, Meta(gt=0)] | None = None
    communication: Any = None
    router: str | None = None
    access: str | None = None
    allowance: Any = None
    state: str | None = None
    ceilings: list[Any] = msgspec.field(default_factory=list)


class AllowanceTable(Table, frozen=True):
    """The limits of an agent's messages; see `mdm.team.transport.allowance.Allowance`."""

    messages: float | None = None
    bytes: float | None = None
    burst: float | None = None


class CeilingTable(Table, frozen=True):
    """The most that Zenoh lets through; see `mdm.team.transport.ceilings.Ceiling`."""

    keys: str
    rate: float | None = None
    size: int | None = None
    priority: Priority | None = None


class TeamFile:
    """A team as a file describes it.

    Args:
        team: The team.
        certificates: The folder of certificates, None where anybody may talk to the team.
        allowance: The limits of each agent's messages; None for no limits.
        state: The folder in which agents keep that they were stopped.
    """

    def __init__(self, team: Team, certificates: Path | None, allowance: AllowanceTable | None, state: Path) -> None:
        self.team = team
        self.state = state
        self._certificates = certificates
        self._allowance = allowance

    def access(self, name: str) -> Access | None:
        """Return the paths of the certificates of an agent, or of another holder, by name."""
        return None if self._certificates is None else access_of(self._certificates, name)

    def options(self, agent: str) -> dict[str, Any]:
        """Return the further arguments of a member of the team.

        Raises:
            ConfigError: If the allowance is none.
        """
        allowance = None if self._allowance is None else Allowance(**stated(self._allowance))
        return {"access": self.access(agent), "allowance": allowance, "state": self.state}


def read_team(given: object, folder: Path, functions: Functions, problems: Problems) -> TeamFile | None:
    """Return the team that a file's table ``team`` describes; None where its agents are not known.

    All problems are noted. Where some have nothing to do with who its agents are, the team returned is one without the
    keys concerned, so that the rest of the file can be checked.

    Agents without an endpoint listen on this machine's loopback, at the table's ``port`` and those that follow: the
    first agent at ``port``, the second at ``port`` + 1.

    Args:
        given: The table.
        folder: The file's folder, to which that of certificates is relative.
        functions: Finds the functions that are named.
        problems: Where problems are noted.
    """
    table: TeamTable | None = problems.convert(given, TeamTable, "team", partly=True)
    if table is None:
        return None
    agents = _agents(table, problems)
    allowance = None if table.allowance is None else problems.convert(table.allowance, AllowanceTable, "team.allowance")
    ceilings = [
        problems.convert(ceiling, CeilingTable, f"team.ceilings.{place}")
        for place, ceiling in enumerate(table.ceilings)
    ]
    if agents is None:
        return None
    apart = {"name", "agents", "port", "access", "allowance", "ceilings", "communication", "state"}
    options = stated(table, *(key for key in table.__struct_fields__ if key not in apart))
    options["ceilings"] = [Ceiling(**msgspec.structs.asdict(ceiling)) for ceiling in ceilings if ceiling is not None]
    options["communication"] = read_communication(table.communication, functions, problems)
    certificates = None if table.access is None else folder / table.access
    state = folder if table.state is None else folder / table.state
    with problems.collecting("team"):
        return TeamFile(Team(table.name, agents, **options), certificates, allowance, state)
    with suppress(ConfigError):  # which has been noted
        return TeamFile(Team(table.name, agents), certificates, allowance, state)
    return None


def _agents(table: TeamTable, problems: Problems) -> list[Agent] | None:
    protocol = "tcp" if table.access is None else "tls"
    agents: list[Agent] = []
    for place, given in enumerate(table.agents):
        written = {"name": given} if isinstance(given, str) else given
        agent: AgentTable | None = problems.convert(written, AgentTable, f"team.agents.{place}")
        if agent is None:
            return None
        port = table.port + place
        addresses = stated(agent, "endpoint", "listen", "connect")
        if not addresses and table.router is None:
            if port > 65535:
                problems.add(f"agent {agent.name!r} would listen at port {port}, and 65535 is the last", "team.port")
                return None
            addresses = {"endpoint": f"{protocol}/127.0.0.1:{port}"}
        agents.append(Agent(agent.name, **addresses))
    return agents
