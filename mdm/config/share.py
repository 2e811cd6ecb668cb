"""The share: one agent's part of a team's file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from mdm.errors import ConfigError
from mdm.logic import Formula, P, similar

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from mdm.config.problems import Problems
    from mdm.config.tables import EnsembleTable
    from mdm.team import Placement, Team

__all__ = ["Seat", "Share"]

_BINDING = ("call", "ensemble", "way", "place")


class Seat(NamedTuple):
    """An agent's part in an ensemble.

    Attributes:
        agent: The model's agent whose component is carried out.
        placement: Where the layers are of an ensemble that the team decides together; None where it is the agent's own.
        acts: Whether the agent carries out a component.
        who: Its name in the team.
    """

    agent: int | str
    placement: Placement | None = None
    acts: bool = True
    who: str = ""


class Share:
    """One agent's part of a team's file.

    Args:
        team: The team.
        agent: Which agent.

    Raises:
        ConfigError: If there is no such agent.
    """

    def __init__(self, team: Team, agent: str) -> None:
        self.team = team
        self.agent = team.check_agent(agent)
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

    def tasks(self, given: object, key: str) -> object:
        """Return this agent's tasks.

        Raises:
            ConfigError: If some are those of no agent.
        """
        if not isinstance(given, dict):
            return given
        for name in given:
            self.team.check_agent(name, key=f"{key}.{name}")
        return given.get(self.agent, [])

    def navigator(self, given: Mapping[str, str]) -> str | None:
        """Return the function that makes this agent's navigator; None where it has none.

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
            here = [name for name, table in tables.items() if name not in under and agent in _agents(table, self.team)]
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
            return Seat(self._own_index(name, table, agents), who=self.agent)
        if table.agent is not None:
            raise ConfigError("in a team each agent acts for itself: leave out agent", key=f"{key}.agent")
        from mdm.team import Placement  # noqa: PLC0415 - files without a team load nothing of teams

        placement = problems.convert(table.placement or {}, Placement, f"{key}.placement") or Placement()
        central = self.team.mode == "centralised" or placement.control is not None
        if table.agents is not None and set(table.agents) != set(self.team.names) and not central:
            raise ConfigError(
                f"all agents of team {self.team.name!r} decide this together: leave out agents, or place its control",
                key=f"{key}.agents",
            )
        acting = self._acting(name, agents, placement)
        acts = self.agent in acting
        return Seat(acting.index(self.agent) if acts else 0, placement, acts, self.agent)

    def _own_index(self, name: str, table: EnsembleTable, agents: Sequence[str]) -> int | str:
        if table.agent is not None:
            return table.agent
        if not table.local or not agents:
            return 0
        acting = self._acting(name, agents)
        return acting.index(self.agent) if self.agent in acting else 0

    def _acting(self, name: str, agents: Sequence[str], placement: Placement | None = None) -> tuple[str, ...]:
        from mdm.team.ownership import matched  # noqa: PLC0415 - files without a team load nothing of teams

        return matched(self.team, name, agents, placement)

    def _below(self, table: Any, agent: str) -> set[str]:
        given = table.get("actions") if isinstance(table, dict) else None
        if not isinstance(given, dict):
            return set()
        own = given.get(agent, {}) if self._by_agent(given) else given
        entries = own.values() if isinstance(own, dict) else ()
        return {
            entry["ensemble"] for entry in entries if isinstance(entry, dict) and isinstance(entry.get("ensemble"), str)
        }


def _agents(table: Any, team: Team) -> Collection[Any]:
    given = table.get("agents") if isinstance(table, dict) else None
    return given if isinstance(given, list) else team.names
