"""The team of a file, from its table ``team``."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta

from mdm.errors import ConfigError
from mdm.logic import similar
from mdm.options import Options
from mdm.team import Always, Budget, Never, OnChange, ValueOfCommunication
from mdm.team.team import FIRST_PORT, Agent, Team, TeamSettings
from mdm.team.transport.access import Access, access_of
from mdm.team.transport.allowance import Allowance
from mdm.team.transport.ceilings import Ceiling

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mdm.config.functions import Functions
    from mdm.config.problems import Problems
    from mdm.team import CommunicationPolicy


__all__ = ["AllowanceTable", "CommunicationTable", "TeamFile", "TeamTable", "read_team"]


class TeamTable(TeamSettings, frozen=True, kw_only=True):
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
    drive: str | float | None = None
    access: str | None = None
    allowance: Any = None
    ceilings: tuple[Any, ...] = ()
    state: str | None = None


class AllowanceTable(Options, frozen=True):
    """The limits of an agent's messages; see `mdm.team.transport.allowance.Allowance`."""

    messages: float | None = None
    bytes: float | None = None
    burst: float | None = None


class TeamFile:
    """A team as a file describes it.

    Args:
        team: The team.
        certificates: The folder of certificates, None where anybody may talk to the team.
        allowance: The limits of each agent's messages; None for no limits.
        state: The folder in which agents keep that they were stopped.
    """

    def __init__(self, team: Team, certificates: Path | None, allowance: dict[str, float] | None, state: Path) -> None:
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
        allowance = None if self._allowance is None else Allowance(**self._allowance)
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
    allowance = table.allowance  # as it was written
    if allowance is not None and problems.convert(allowance, AllowanceTable, "team.allowance") is None:
        allowance = None
    ceilings = [
        problems.convert(ceiling, Ceiling, f"team.ceilings.{place}") for place, ceiling in enumerate(table.ceilings)
    ]
    if agents is None:
        return None
    options = table.as_arguments(TeamSettings)
    options["ceilings"] = [ceiling for ceiling in ceilings if ceiling is not None]
    options["state"] = None  # which each agent's own says
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
        agent: Agent | None = problems.convert(written, Agent, f"team.agents.{place}")
        if agent is None:
            return None
        port = table.port + place
        if agent == Agent(agent.name) and table.router is None:
            if port > 65535:
                problems.add(f"agent {agent.name!r} would listen at port {port}, and 65535 is the last", "team.port")
                return None
            agent = Agent(agent.name, f"{protocol}/127.0.0.1:{port}")
        agents.append(agent)
    return agents


_KINDS: dict[str, tuple[Any, tuple[str, ...], tuple[str, ...]]] = {
    "always": (Always, (), ()),
    "never": (Never, (), ()),
    "on_change": (OnChange, (), ()),
    "budget": (Budget, ("messages_per_second",), ("of", "burst")),
    "value_of_communication": (ValueOfCommunication, ("threshold",), ()),
}
"""What makes each of them, and the keys that it needs and takes."""


class CommunicationTable(Options, frozen=True):
    """A communication policy; short form: its name.

    Attributes:
        policy: ``always``, ``never``, ``on_change``, ``budget`` or ``value_of_communication``.
    """

    policy: str
    messages_per_second: float | None = None
    burst: int | None = None
    of: str | None = None
    threshold: float | None = None


def read_communication(
    given: object, functions: Functions, problems: Problems, *, key: str = "team.communication"
) -> CommunicationPolicy | None:
    """Return a communication policy; None where there is none, or it has problems, which are noted.

    Args:
        given: A name, a function ``module:name`` that returns a policy, or a table of a name and its settings.
        functions: Finds the function.
        problems: Where problems are noted.
        key: Where it stands in the file.
    """
    if given is None:
        return None
    if isinstance(given, str) and ":" in given:
        make = functions.find(given, key)
        with problems.collecting(key):
            return None if make is None else _made(make, given)
        return None
    written = {"policy": given} if isinstance(given, str) else given
    table: CommunicationTable | None = problems.convert(written, CommunicationTable, key)
    if table is not None:
        with problems.collecting(key):
            return _policy(table, functions, problems, key)
    return None


def _made(make: Callable[[], Any], name: str) -> CommunicationPolicy | None:
    try:
        return make()  # type: ignore[no-any-return]
    except Exception as error:
        raise ConfigError(f"{name!r} makes no communication policy: {type(error).__name__}: {error}") from None


def _policy(table: CommunicationTable, functions: Functions, problems: Problems, key: str) -> CommunicationPolicy:
    if table.policy not in _KINDS:
        hint = (
            similar(table.policy, _KINDS) or f"; there are {', '.join(_KINDS)}, and 'module:name' for one of your own"
        )
        raise ConfigError(f"there is no communication policy {table.policy!r}{hint}")
    kind, needed, taken = _KINDS[table.policy]
    settings = {name: value for name, value in msgspec.structs.asdict(table).items() if value is not None}
    del settings["policy"]
    for name in settings:
        if name not in {*needed, *taken}:
            raise ConfigError(f"{name!r} means nothing for the communication policy {table.policy!r}")
    for name in needed:
        if name not in settings:
            raise ConfigError(f"the communication policy {table.policy!r} needs {name!r}")
    if "of" in settings:
        settings["of"] = read_communication(settings["of"], functions, problems, key=f"{key}.of")
    policy: CommunicationPolicy = kind(**settings)
    return policy
