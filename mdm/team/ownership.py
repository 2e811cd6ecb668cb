"""Ownership: which agent tells a factor of the joint input and carries out an action, and where layers are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mdm.errors import ConfigError
from mdm.options import Options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.actors import Ensemble, ObservationFactor, StateFactor
    from mdm.models import Factor
    from mdm.team.team import Team


class Placement(Options, frozen=True):
    """Where an ensemble's layers are, where that is not said by the agents' names.

    Args:
        control: The agent that decides; None for the team's own way: every agent where it is replicated, its controller
            where it is centralised.
        actions: The agent that carries out the actions, or one for each agent of the model, by name; by default the
            agent of the same name or, where there are as many, in the same order.
        inputs: The agent whose sensors give the input of decisions; by default the owners of the factors.

    Example::

        off_board = mdm.team.Placement(control="base", actions="robot", inputs="robot")
        off_board.control  # 'base'
    """

    control: str | None = None
    actions: str | dict[str, str] | None = None
    inputs: str | None = None


def placement_of(given: Placement | Mapping[str, Any]) -> Placement:
    """Return a placement; a mapping has its arguments by name.

    Raises:
        ConfigError: If it is none.
    """
    if isinstance(given, Placement):
        return given
    if not isinstance(given, Mapping):
        raise ConfigError(f"a placement is a mdm.team.Placement(...), or a mapping, not {given!r}", key="placement")
    return Placement.from_keywords(given, below="placement.")


class Ownership:
    """The factors of an ensemble's input, and whose they are.

    A factor belongs to the agent that its ``owner`` names, else to the agent of its own name; observation factors that
    have neither, one for each agent, belong to the agents in their order.

    Args:
        team: The team.
        ensemble: The ensemble; it declares the factors of all agents.
        placement: Where its layers are.

    Raises:
        ConfigError: If a factor is nobody's, or is not declared.

    Attributes:
        names: The factors, the first the most significant.
        sizes: How many values each has.
        owners: The agent of each.
        of: The places of each agent's factors, by agent.
        idle: Of each observation factor, the symbol for "no event"; None where there is none.
        hold: Of each observation factor, whether it keeps its last symbol.
    """

    def __init__(self, team: Team, ensemble: Ensemble, placement: Placement | None = None) -> None:
        self.takes = ensemble.controller.takes
        key = f"ensembles.{ensemble.name}.{'states' if self.takes == 'state' else 'observations'}"
        inputs = None if placement is None else placement.inputs
        self._all_of = None if inputs is None else team.check_agent(inputs, key=f"ensembles.{ensemble.name}.placement")
        declared: Sequence[StateFactor | ObservationFactor | Factor]
        if self.takes == "state":
            if ensemble.state is None:
                raise ConfigError(
                    f"ensemble {ensemble.name!r} decides on states: declare its state factors, of which each agent "
                    "tells its own",
                    key=key,
                )
            declared = ensemble.state.factors
            self.sizes = tuple(factor.size for factor in ensemble.state.factors)
            self.idle: tuple[int | None, ...] = (None,) * len(declared)
            self.hold = (True,) * len(declared)
        elif ensemble.observation is not None:
            declared = ensemble.observation.factors
            self.sizes = tuple(factor.size for factor in ensemble.observation.factors)
            self.idle = tuple(factor.idle for factor in ensemble.observation.factors)
            self.hold = tuple(factor.hold for factor in ensemble.observation.factors)
        else:
            space = ensemble.controller.symbols.observation_space
            if space is None:
                raise ConfigError(f"ensemble {ensemble.name!r} needs a model with observations", key=key)
            declared = space.factors
            self.sizes = space.shape
            self.idle = (None,) * len(declared)
            self.hold = (False,) * len(declared)
        factors: list[StateFactor | ObservationFactor | Factor] = list(declared)
        self.names = tuple(factor.name for factor in factors)
        self.symbols = tuple(_symbols(factor) for factor in factors)
        self.owners = tuple(
            self._owner(team, factor, place, len(self.names), f"{key}.{factor.name}")
            for place, factor in enumerate(factors)
        )
        self.of = {
            agent: tuple(place for place, owner in enumerate(self.owners) if owner == agent) for agent in team.names
        }
        strides = [1]
        for size in reversed(self.sizes[1:]):
            strides.insert(0, strides[0] * size)
        self._strides = tuple(strides)

    def _owner(
        self, team: Team, factor: StateFactor | ObservationFactor | Factor, place: int, count: int, key: str
    ) -> str:
        owner = getattr(factor, "owner", None)
        if owner is None:
            owner = self._all_of
        if owner is not None:
            return team.check_agent(owner, key=f"{key}.owner")
        if factor.name in team.names:
            return factor.name
        if self.takes != "state" and count == len(team.names):
            return team.names[place]
        raise ConfigError(
            f"no agent of team {team.name!r} tells the {self.takes} factor {factor.name!r}: give it an owner "
            f"({', '.join(team.names)})",
            key=key,
        )

    def named(self, agent: str) -> tuple[str, ...]:
        """Return the names of an agent's factors."""
        return tuple(self.names[place] for place in self.of[agent])

    def index(self, values: Sequence[int | None]) -> int | None:
        """Return the joint index of values; None where one is missing."""
        total = 0
        for value, stride in zip(values, self._strides, strict=True):
            if value is None:
                return None
            total += value * stride
        return total

    def facts(self) -> dict[str, str]:
        """Return facts that must be the same at every agent."""
        return {
            f"{self.takes} factor {name!r}": f"{size} values, of {owner}, idle {idle}, {'held' if hold else 'not held'}"
            for name, size, owner, idle, hold in zip(
                self.names, self.sizes, self.owners, self.idle, self.hold, strict=True
            )
        }


def _symbols(factor: StateFactor | ObservationFactor | Factor) -> Sequence[str]:
    names = getattr(factor, "names", None)
    if names is not None:
        return names  # type: ignore[no-any-return]
    symbols = getattr(factor, "symbols", None)
    size = factor.size  # type: ignore[union-attr]
    return [str(symbol) for symbol in (symbols if symbols is not None and len(symbols) == size else range(size))]


def acting(team: Team, ensemble: Ensemble, placement: Placement | None = None) -> tuple[str, ...]:
    """Return the agents of the team in the order of the model's agents, who carry out its components.

    They are matched as the placement says; else by name where the model's agents have names of the team's, else by
    order.

    Raises:
        ConfigError: If the model has another number of agents, or there is none.
    """
    space = ensemble.controller.symbols.action_space
    if space is None:
        raise ConfigError(
            f"ensemble {ensemble.name!r} of a team needs a model, which says which agent does what",
            key=f"ensembles.{ensemble.name}.model",
        )
    return matched(team, ensemble.name, [factor.name for factor in space.factors], placement)


def matched(team: Team, ensemble: str, names: Sequence[str], placement: Placement | None = None) -> tuple[str, ...]:
    """Return the agents of the team that carry out the components of a model's agents, in their order.

    Raises:
        ConfigError: If there are more or fewer, and the placement does not say who is meant.
    """
    key = f"ensembles.{ensemble}"
    actions = None if placement is None else placement.actions
    if actions is not None:
        given = {names[0]: actions} if isinstance(actions, str) else actions
        if given.keys() != set(names):
            raise ConfigError(
                f"the placement of actions names {', '.join(map(repr, given))}, but the model of ensemble "
                f"{ensemble!r} has the agents {', '.join(names)}: name an agent of the team for each",
                key=f"{key}.placement",
            )
        return tuple(team.check_agent(given[name], key=f"{key}.placement") for name in names)
    known = [name for name in names if name in team.names]
    if len(known) == len(names):
        return tuple(names)
    if known:
        other = next(name for name in names if name not in known)
        raise ConfigError(
            f"the model of ensemble {ensemble!r} has an agent {known[0]!r}, as team {team.name!r} has, and {other!r}, "
            f"which the team does not have ({', '.join(team.names)}): say in its placement who acts for each",
            key=f"{key}.placement",
        )
    if len(names) == len(team.names):
        return team.names
    raise ConfigError(
        f"the model of ensemble {ensemble!r} has {len(names)} agents ({', '.join(names)}), but team "
        f"{team.name!r} has {len(team.names)} ({', '.join(team.names)})",
        key=f"{key}.model",
    )
