"""The observation layer: from events to factored joint observations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.actors.layer import Layer
from mdm.actors.wiring import arrange
from mdm.errors import ConfigError
from mdm.logic import similar
from mdm.logic.inputs import Memory
from mdm.messages import EventUpdate, Observation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors.abstraction.factors import ObservationFactor
    from mdm.actors.predicates.predicate_manager import PredicateManager
    from mdm.actors.wiring import Wire
    from mdm.models import Space

__all__ = ["ObservationLayer"]


_FEW = 8


class ObservationLayer(Layer):
    """Publishes the joint `Observation` on ``observation`` whenever an event of one of its factors occurs.

    A layer that covers an agent's own factors alone publishes on ``own_observation``; of others it says nothing.

    Args:
        factors: By name where the model names its factors or agents, else in the model's order, first the most
            significant.
        predicates: The predicate manager of these events.
        space: The model's observation space, to arrange the factors by and to check them against.
    """

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = (
        "_known",
        "_published",
    )

    def __init__(
        self,
        factors: Iterable[ObservationFactor],
        predicates: PredicateManager,
        *,
        space: Space | None = None,
        name: str = "observation",
    ) -> None:
        super().__init__(name)
        self.factors, self._misplaced = arrange(factors, space, "observation factor")
        self.predicates = predicates
        predicates.declared.use(*(name for factor in self.factors for name in factor.events if name is not None))
        self.space = space
        self.conflicts = 0
        self.own = self.factors
        self._covers: frozenset[str] | None = None
        self._places: dict[str, tuple[int, int]] = {}
        self._rest: list[int | None] = []
        self._strides: tuple[int, ...] = ()
        self._holds = any(factor.hold for factor in self.factors)
        self._known: Memory[tuple[str, ...], tuple[int | None, tuple[int | None, ...], tuple[bool, ...]]] = Memory()

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
        """Return the wire of each symbol of each factor."""
        wires = (wire for factor in self.factors for wire in factor.wires())
        return tuple(wire if self._is_declared(wire.source) else wire._replace(source=None) for wire in wires)

    def problems(self) -> Iterator[ConfigError]:
        """Yield the faults of the factors: against the events declared, each other, and the model."""
        yield from self.shared_events()
        yield from self.misfits()

    def shared_events(self) -> Iterator[ConfigError]:
        """Yield the events that several factors of this agent have."""
        owners: dict[str, str] = {}
        for factor in self.own:
            for event in factor.events:
                if event is None:
                    continue
                if event in owners:
                    yield ConfigError(
                        f"event {event!r} belongs to the observation factors {owners[event]!r} and {factor.name!r}; "
                        "an event belongs to one factor only",
                        key=f"{self.key}.{factor.name}",
                    )
                owners[event] = factor.name

    def misfits(self) -> Iterator[ConfigError]:
        """Yield the faults of each factor by itself, whoever owns it: against the events declared, and the model."""
        for factor in self.own:
            for position, event in enumerate(factor.events):
                if event is not None and not self._is_declared(event) and position != factor.idle:
                    events = [known for known, kind in self.predicates.declared.names.items() if kind == "event"]
                    yield ConfigError(
                        f"observation factor {factor.name!r} uses {event!r}, which is no declared event"
                        f"{similar(event, events)}",
                        key=f"{self.key}.{factor.name}",
                    )
        yield from (ConfigError(p.message, key=".".join(filter(None, (self.key, p.key)))) for p in self._misplaced)

    def on_start(self) -> None:
        """Listen to the events."""
        for problem in self.problems():
            raise problem
        self._published = self.owner.channel("observation" if self._covers is None else "own_observation", Observation)
        self._known.clear()
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
        # Hot path: the meaning of events is looked up, unless it depends on those before, or must be reported.
        known = self._known.get(update.events)
        if known is not None:
            self._published.emit_last(Observation(update.time, *known))
            return
        new: dict[int, int] = {}
        plain = not self._holds
        for event in update.events:
            place = self._places.get(event)
            if place is not None:
                component, symbol = place
                if component in new:
                    plain = False
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
        if plain and len(update.events) <= _FEW:
            self._known.keep(update.events, (index, tuple(values), mask))
        self._published.emit_last(Observation(update.time, index, tuple(values), mask))

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
