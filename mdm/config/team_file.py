"""The team of a file, from its table ``team``; and one agent's part of the file."""

from __future__ import annotations

import inspect
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from mdm.config.ensembles import Seat
from mdm.errors import ConfigError
from mdm.logic import Formula, P, similar
from mdm.options import Options
from mdm.team import Always, Budget, Never, OnChange, ValueOfCommunication
from mdm.team.ownership import Placement, matched
from mdm.team.team import FIRST_PORT, Agent, Team, TeamSettings
from mdm.team.transport.access import Access, access_of
from mdm.team.transport.allowance import Allowance
from mdm.team.transport.settings import Ceiling

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

    from mdm.config.functions import Functions
    from mdm.config.tables import EnsembleTable, Problems
    from mdm.team import CommunicationPolicy


class TeamTable(TeamSettings, frozen=True, kw_only=True):
    """The team that a file is of, see `mdm.Team`; agents are converted separately.

    Attributes:
        port: Agents without an endpoint listen on this machine: the first at this port, the second at the next one.
        router: The endpoint of a router, through which all agents talk; they then listen nowhere.
        access: A folder with ``authority.pem``, and ``NAME.pem`` and ``NAME.key.pem`` of each agent: mutual TLS.
        allowance: The most that each agent may send; by default anything.
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

    def share(self, agent: str | None) -> Share:
        """Return an agent's part of the file.

        Raises:
            ConfigError: If none is named, or there is no such agent.
        """
        if agent is None:
            names = ", ".join(self.team.names)
            raise ConfigError(f"this file describes a team: say which agent's part: {names}")
        return Share(self.team, agent)

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
    team = problems.attempt("team", Team, table.name, agents, **options)
    if team is None:
        with suppress(ConfigError):  # which has been noted
            team = Team(table.name, agents)
    return None if team is None else TeamFile(team, certificates, allowance, state)


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


KINDS: dict[str, Callable[..., CommunicationPolicy]] = {
    "always": Always,
    "never": Never,
    "on_change": OnChange,
    "budget": Budget,
    "value_of_communication": ValueOfCommunication,
}
"""Each communication policy by its name; the keys of a table are its arguments."""


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
        return None if make is None else problems.attempt(key, _made, make, given)
    written = {"policy": given} if isinstance(given, str) else given
    table: CommunicationTable | None = problems.convert(written, CommunicationTable, key)
    return None if table is None else problems.attempt(key, _policy, table, functions, problems, key)


def _made(make: Callable[[], Any], name: str) -> CommunicationPolicy | None:
    try:
        return make()  # type: ignore[no-any-return]
    except Exception as error:
        raise ConfigError(f"{name!r} makes no communication policy: {type(error).__name__}: {error}") from None


def _policy(table: CommunicationTable, functions: Functions, problems: Problems, key: str) -> CommunicationPolicy:
    if table.policy not in KINDS:
        hint = similar(table.policy, KINDS) or f"; there are {', '.join(KINDS)}, and 'module:name' for one of your own"
        raise ConfigError(f"there is no communication policy {table.policy!r}{hint}")
    kind = KINDS[table.policy]
    arguments = inspect.signature(kind).parameters
    settings = {name: value for name, value in msgspec.structs.asdict(table).items() if value is not None}
    del settings["policy"]
    for name in settings:
        if name not in arguments:
            raise ConfigError(f"the communication policy {table.policy!r} has no key {name!r}")
    for name, argument in arguments.items():
        if argument.default is argument.empty and name not in settings:
            raise ConfigError(f"the communication policy {table.policy!r} needs {name!r}")
    if "of" in settings:
        settings["of"] = read_communication(settings["of"], functions, problems, key=f"{key}.of")
    return kind(**settings)


# -- One agent's part ----------------------------------------------------------------------------------------------

T = TypeVar("T")

_BINDING = ("call", "ensemble", "way", "place")


class Share:
    """One agent's part of a team's file.

    Args:
        team: The team.
        agent: Which agent.

    Raises:
        ConfigError: If there is no such agent.

    Attributes:
        memory: The most megabytes that a model may take, where its ensemble does not say; None for no such limit.
    """

    def __init__(self, team: Team, agent: str) -> None:
        self.team = team
        self.agent = team.check_agent(agent)
        self.memory: float | None = team.memory
        self._under: set[str] = set()

    # -- Names ---------------------------------------------------------------------------------------------------

    def name(self, name: str) -> str:
        """Return a predicate or event as this agent calls it: its own without the agent's name."""
        return name.removeprefix(f"{self.agent}/")

    def formula(self, formula: Formula) -> Formula:
        """Return a formula with this agent's own names without the agent's name."""
        if isinstance(formula, P):
            return P(self.name(formula.name))
        return type(formula)(*map(self.formula, formula.parts)) if formula.parts else formula

    def wires(self, given: list[str] | dict[str, str], declared: Collection[str]) -> list[str] | dict[str, str]:
        """Return the predicates or events of a factor as this agent calls them.

        Raises:
            ConfigError: If one is that of another agent, and there is none such.
        """
        for name in given if isinstance(given, list) else given.values():
            self.check_name(name, declared)
        if isinstance(given, list):
            return [self.name(name) for name in given]
        return {symbol: self.name(name) for symbol, name in given.items()}

    def check_name(self, name: str, declared: Collection[str]) -> None:
        """Refuse a name such as ``robot2/IsMoving`` of no agent, or that the file does not declare.

        Raises:
            ConfigError: In either case.
        """
        agent, slash, rest = name.partition("/")
        if slash:
            self.team.check_agent(agent)
            if rest not in declared:
                raise ConfigError(f"{name!r} is not declared: {rest!r} would be{similar(rest, declared)}")

    # -- Tables --------------------------------------------------------------------------------------------------

    def actions(self, given: Mapping[str, Any], key: str) -> Mapping[str, Any] | None:
        """Return this agent's actions: its own table, or that of all; None where it has none of its own.

        Raises:
            ConfigError: If a table is that of no agent.
        """
        return given if not self._by_agent(given) else self._own(given, key)

    def _by_agent(self, given: Mapping[str, Any]) -> bool:
        return any(
            name in self.team.names and isinstance(value, dict) and not any(key in value for key in _BINDING)
            for name, value in given.items()
        )

    def _own(self, given: Mapping[str, Any], key: str) -> Any:
        for name, value in given.items():
            self.team.check_agent(name, key=f"{key}.{name}")
            if not isinstance(value, dict):
                raise ConfigError(f"a table of the actions of agent {name!r} was expected, not {value!r}", key=key)
        return given.get(self.agent)

    def own(self, given: Mapping[str, T]) -> T | None:
        """Return this agent's entry of a table with one for each agent; None where it has none.

        Raises:
            ConfigError: If one is that of no agent.
        """
        for name in given:
            self.team.check_agent(name)
        return given.get(self.agent)

    # -- Ensembles -----------------------------------------------------------------------------------------------

    def survey(self, tables: Mapping[str, Any]) -> set[str]:
        """Return the ensembles that other agents have, and this one has not; call this before `seat`.

        Args:
            tables: The ensembles' tables by name, as they are in the file.
        """
        agents = self.team.names
        below = {name: {agent: self._below(table, agent) for agent in agents} for name, table in tables.items()}
        under = self._under = {child for children in below.values() for names in children.values() for child in names}
        reached: dict[str, set[str]] = {}
        for agent in agents:
            here = [name for name, table in tables.items() if name not in under and agent in _having(table, self.team)]
            seen = reached[agent] = set(here)
            while here:
                new = below.get(here.pop(), {}).get(agent, set()) - seen
                seen |= new
                here += new
        return set().union(*reached.values()) - reached[self.agent]

    def seat(self, name: str, table: EnsembleTable, agents: Sequence[str], problems: Problems) -> Seat:
        """Return this agent's part in an ensemble.

        An ensemble at the top is the team's where its model has several agents or it has a placement, and it is not
        ``local``. Others are each agent's own.

        Args:
            name: The ensemble's name.
            table: Its table.
            agents: The agents of its model; none without a model.
            problems: Where problems of the placement are noted.

        Raises:
            ConfigError: If the table contradicts that.
        """
        key, top = f"ensembles.{name}", name not in self._under
        if table.agents is not None and not top:
            raise ConfigError("an ensemble runs where the one above it runs: leave out agents", key=f"{key}.agents")
        for agent in table.agents or ():
            self.team.check_agent(agent, key=f"{key}.agents")
        joint = top and not table.local and (table.placement is not None or len(agents) > 1)
        if not joint:
            if table.placement is not None:
                raise ConfigError("a placement is for what a team decides together", key=f"{key}.placement")
            if table.agent is not None:
                return Seat(table.agent, who=self.agent)
            acting = matched(self.team, name, agents, None) if table.local and agents else ()
            return Seat(acting.index(self.agent) if self.agent in acting else 0, who=self.agent)
        if table.agent is not None:
            raise ConfigError("in a team each agent acts for itself: leave out agent", key=f"{key}.agent")
        placement = problems.convert(table.placement or {}, Placement, f"{key}.placement") or Placement()
        central = self.team.mode == "centralised" or placement.control is not None
        if table.agents is not None and set(table.agents) != set(self.team.names) and not central:
            raise ConfigError(
                f"all agents of team {self.team.name!r} decide this together: leave out agents, or place its control",
                key=f"{key}.agents",
            )
        acting = matched(self.team, name, agents, placement)
        acts = self.agent in acting
        return Seat(acting.index(self.agent) if acts else 0, placement, acts, self.agent)

    def _below(self, table: Any, agent: str) -> set[str]:
        given = table.get("actions") if isinstance(table, dict) else None
        if not isinstance(given, dict):
            return set()
        own = given.get(agent, {}) if self._by_agent(given) else given
        entries = own.values() if isinstance(own, dict) else ()
        return {
            entry["ensemble"] for entry in entries if isinstance(entry, dict) and isinstance(entry.get("ensemble"), str)
        }


def _having(table: Any, team: Team) -> Collection[Any]:
    given = table.get("agents") if isinstance(table, dict) else None
    return given if isinstance(given, list) else team.names
