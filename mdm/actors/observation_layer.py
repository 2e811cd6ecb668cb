"""The observation layer: from events to factored joint observations."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

from mdm.actors.layer import Layer
from mdm.actors.wiring import Wire, arrange, check_name, check_owner, index_order, named, places
from mdm.errors import ConfigError
from mdm.logic import similar
from mdm.messages import EventUpdate, Observation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors.predicates.predicate_manager import PredicateManager
    from mdm.actors.wiring import Names
    from mdm.models import Factor, Space

__all__ = ["ObservationFactor", "ObservationLayer"]


class ObservationFactor:
    """One component of the observation: which of its events occurred last.

    Args:
        name: The factor's name, as in the model where the model names its factors.
        events: A list in the order of the model's symbols, or a mapping from the model's symbols, by name or by index;
            names without a model stand in the mapping's order. An event belongs to one factor only.
        idle: The symbol that stands for "no event". Of a list it is one of the events, which then need not be
            declared; of a mapping it is a symbol, which then needs no event.
        hold: Keep the last symbol where no event is new. Without ``idle`` and ``hold`` the component is missing, and
            the belief update sums over it.
        owner: In a team, the agent whose sensors tell it; by default the one of the factor's name.

    Example:
        >>> ObservationFactor("camera", {"closed": "SawClosed", "open": "SawOpen"}, idle="nothing")
    """

    __slots__ = ("events", "hold", "idle", "name", "owner", "symbols")

    def __init__(
        self,
        name: str,
        events: Names,
        *,
        idle: str | int | None = None,
        hold: bool = False,
        owner: str | None = None,
    ) -> None:
        check_name(name, "an observation factor")
        check_owner(owner, f"observation factor {name!r}")
        self.owner = owner
        what = f"observation factor {name!r}"
        given, self.symbols = named(events, what, "event")
        if self.symbols and idle is not None and type(idle) is not type(self.symbols[0]):
            raise ConfigError(f"the idle symbol {idle!r} of {what} is given as the others are", key=name)
        self.name = name
        self.events: tuple[str | None, ...] = given
        if self.symbols is not None and idle is not None and idle not in self.symbols:
            self.symbols, self.events = (*self.symbols, idle), (*given, None)
        if len(self.events) < 2:
            raise ConfigError(f"{what} needs at least two events, not {events!r}", key=name)
        known: tuple[str | int, ...] = given if self.symbols is None else self.symbols
        if idle is not None and idle not in known:
            raise ConfigError(f"the idle symbol {idle!r} of {what} is none of {', '.join(given)}", key=name)
        if idle is not None and hold:
            raise ConfigError(f"{what} can take its idle symbol or hold the last one, not both", key=name)
        if self.symbols is not None and (order := index_order(self.symbols, self.size, what)) is not None:
            self.events = tuple(self.events[place] for place in order)
            self.symbols = known = tuple(range(self.size))
        self.idle = None if idle is None else known.index(idle)
        self.hold = hold

    @property
    def size(self) -> int:
        """How many symbols it has."""
        return len(self.events)

    @property
    def by_symbol(self) -> bool:
        """Whether the events were given by symbol."""
        return self.symbols is not None

    def arranged(self, factor: Factor) -> ObservationFactor:
        """Return it with the events in the order of a model's factor."""
        what = f"observation factor {self.name!r}"
        new = copy(self)
        if self.symbols is not None:
            found = places(self.symbols, factor, what)
            new.events = tuple(self.events[found.index(place)] for place in range(len(factor)))
            new.idle = None if self.idle is None else found[self.idle]
        if new.size != len(factor):
            raise ConfigError(f"{what} has {new.size} symbols, but the model's has {len(factor)}")
        new.symbols = tuple(factor.names)
        return new


class ObservationLayer(Layer):
    """Publishes the joint `Observation` on ``observation`` whenever an event of one of its factors occurs.

    A layer that covers an agent's own factors alone publishes on ``own_observation``; of others it says nothing.

    Args:
        factors: By name where the model names its factors or agents, else in the model's order, first the most
            significant.
        predicates: The predicate manager, whose events these are.
        space: The model's observation space, to arrange the factors by and to check them against.
    """

    def __init__(
        self,
        factors: Iterable[ObservationFactor],
        predicates: PredicateManager,
        *,
        space: Space | None = None,
        name: str = "observation",
    ) -> None:
        super().__init__(name)
        self.factors, self._misplaced = arrange(factors, space, "observation factor", complete=True)
        self.predicates = predicates
        predicates.declared.use(*(name for factor in self.factors for name in factor.events if name is not None))
        self.space = space
        self.conflicts = 0
        self.own = self.factors
        self._covers: frozenset[str] | None = None
        self._places: dict[str, tuple[int, int]] = {}
        self._rest: list[int | None] = []
        self._strides: tuple[int, ...] = ()

    @property
    def key(self) -> str:
        """Where the factors stand in a configuration."""
        return f"ensembles.{self.owner.name}.observations"

    def cover(self, names: Iterable[str]) -> None:
        """Observe nothing but these factors, and tell it on ``own_observation``: a team puts the parts together."""
        self._covers = frozenset(names)
        self.own = tuple(factor for factor in self.factors if factor.name in self._covers)

    def _is_declared(self, event: str | None) -> bool:
        return event is not None and self.predicates.declared.knows(event) == "event"

    def wires(self) -> tuple[Wire, ...]:
        """Return what stands for each symbol of each factor."""
        return tuple(
            Wire(
                factor.name,
                str(place if factor.symbols is None else factor.symbols[place]),
                event if self._is_declared(event) else None,
                idle=place == factor.idle,
            )
            for factor in self.factors
            for place, event in enumerate(factor.events)
        )

    def problems(self) -> Iterator[ConfigError]:
        """Yield what is wrong with the factors: against the events declared, each other, and the model."""
        owners: dict[str, str] = {}
        for factor in self.own:
            key = f"{self.key}.{factor.name}"
            for position, event in enumerate(factor.events):
                if event is None:
                    continue
                if not self._is_declared(event) and position != factor.idle:
                    events = [known for known, kind in self.predicates.declared.names.items() if kind == "event"]
                    yield ConfigError(
                        f"observation factor {factor.name!r} uses {event!r}, which is no declared event"
                        f"{similar(event, events)}",
                        key=key,
                    )
                if event in owners:
                    yield ConfigError(
                        f"event {event!r} belongs to the observation factors {owners[event]!r} and {factor.name!r}; "
                        "an event belongs to one factor only",
                        key=key,
                    )
                owners[event] = factor.name
        yield from (ConfigError(p.message, key=".".join(filter(None, (self.key, p.key)))) for p in self._misplaced)

    def on_start(self) -> None:
        """Listen to the events."""
        for problem in self.problems():
            raise problem
        self._published = self.owner.channel("observation" if self._covers is None else "own_observation", Observation)
        self._places = {
            event: (component, symbol)
            for component, factor in enumerate(self.factors)
            for symbol, event in enumerate(factor.events)
            if event is not None and factor in self.own
        }
        self._rest = [factor.idle if factor in self.own else None for factor in self.factors]
        strides: list[int] = []
        stride = 1
        for factor in reversed(self.factors):
            strides.insert(0, stride)
            stride *= len(factor.events)
        self._strides = tuple(strides)
        self.subscribe(self.predicates.events, self._update, topics=self._places)

    def _update(self, update: EventUpdate) -> None:
        new: dict[int, int] = {}
        for event in update.events:
            place = self._places.get(event)
            if place is not None:
                component, symbol = place
                if component in new:
                    self._conflict(component, new[component], symbol, update.time)
                    symbol = min(symbol, new[component])
                new[component] = symbol
        if not new:
            return
        index: int | None = 0
        values: list[int | None] = []
        for component, (rest, stride) in enumerate(zip(self._rest, self._strides, strict=True)):
            symbol_or_rest = new.get(component, rest)
            values.append(symbol_or_rest)
            index = None if index is None or symbol_or_rest is None else index + symbol_or_rest * stride
        for component, symbol in new.items():
            if self.factors[component].hold:
                self._rest[component] = symbol
        mask = tuple([component in new for component in range(len(values))])
        self._published.emit(Observation(update.time, index, tuple(values), mask))

    def _conflict(self, component: int, first: int, second: int, time: int) -> None:
        factor = self.factors[component]
        self.conflicts += 1
        took, left = sorted((first, second))
        self.report(
            "violation",
            f"observation factor {factor.name!r}: {factor.events[took]} and {factor.events[left]} occurred at once, "
            f"though one symbol is observed at a time; took {factor.events[took]}",
            time=time,
        )
