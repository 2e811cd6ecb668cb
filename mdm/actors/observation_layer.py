"""The observation layer: from events to factored joint observations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.actors.layer import Layer
from mdm.errors import ConfigError
from mdm.logic import similar
from mdm.messages import EventUpdate, Observation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from mdm.actors.predicate_manager import PredicateManager
    from mdm.models import Space

__all__ = ["ObservationFactor", "ObservationLayer"]


class ObservationFactor:
    """One component of the observation: which of its events occurred last.

    Args:
        name: The factor's name, as in the model where the model has names.
        events: At least two, in the order of the model's symbols; an event belongs to one factor only.
        idle: The symbol that stands for "no event": one of ``events``, which then need not be a declared event.
        hold: Keep the last symbol where no event is new. Without ``idle`` and ``hold`` the component is missing, and
            the belief update sums over it.
    """

    __slots__ = ("events", "hold", "idle", "name")

    def __init__(self, name: str, events: Sequence[str], *, idle: str | None = None, hold: bool = False) -> None:
        if isinstance(events, str) or len(events) < 2:
            raise ConfigError(f"observation factor {name!r} needs at least two events, not {events!r}", key=name)
        if len(set(events)) != len(events):
            raise ConfigError(f"observation factor {name!r} names an event twice: {', '.join(events)}", key=name)
        if idle is not None and idle not in events:
            raise ConfigError(
                f"the idle symbol {idle!r} of observation factor {name!r} is none of {', '.join(events)}", key=name
            )
        if idle is not None and hold:
            raise ConfigError(
                f"observation factor {name!r} can take its idle symbol or hold the last one, not both", key=name
            )
        self.name = name
        self.events = tuple(events)
        self.idle = None if idle is None else self.events.index(idle)
        self.hold = hold


class ObservationLayer(Layer):
    """Publishes the joint `Observation` on ``observation`` whenever an event of one of its factors occurs.

    Args:
        factors: In the order of the model's factors or agents, first the most significant.
        predicates: The predicate manager, whose events these are.
        space: The model's observation space, to check names and sizes against.
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
        self.factors = tuple(factors)
        self.predicates = predicates
        predicates.use(*(name for factor in self.factors for name in factor.events))
        self.space = space
        self.conflicts = 0
        self._places: dict[str, tuple[int, int]] = {}
        self._rest: list[int | None] = []
        self._strides: tuple[int, ...] = ()

    @property
    def key(self) -> str:
        """Where the factors stand in a configuration."""
        return f"ensembles.{self.owner.name}.observations"

    def problems(self) -> Iterator[ConfigError]:
        """Yield what is wrong with the factors: against the events declared, each other, and the model."""
        owners: dict[str, str] = {}
        for factor in self.factors:
            key = f"{self.key}.{factor.name}"
            for position, event in enumerate(factor.events):
                if self.predicates.knows(event) != "event" and position != factor.idle:
                    events = [known for known, kind in self.predicates.names.items() if kind == "event"]
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
        if self.space is not None:
            yield from self._mismatches(self.space)

    def _mismatches(self, space: Space) -> Iterator[ConfigError]:
        sizes = [len(factor) for factor in space.factors]
        product = 1
        for factor in self.factors:
            product *= len(factor.events)
        if len(sizes) == 1 and product == len(space):
            return  # a model without factors: the joint index is what counts
        if len(self.factors) != len(sizes):
            yield ConfigError(
                f"{len(self.factors)} observation factors do not make up the model's {len(sizes)} "
                f"({', '.join(f'{factor.name}: {len(factor)}' for factor in space.factors)})",
                key=self.key,
            )
            return
        for factor, size in zip(self.factors, sizes, strict=True):
            if len(factor.events) != size:
                yield ConfigError(
                    f"observation factor {factor.name!r} has {len(factor.events)} symbols, but the model's has {size}",
                    key=f"{self.key}.{factor.name}",
                )

    def on_start(self) -> None:
        """Listen to the events."""
        for problem in self.problems():
            raise problem
        self._published = self.owner.channel("observation", Observation)
        self._places = {
            event: (component, symbol)
            for component, factor in enumerate(self.factors)
            for symbol, event in enumerate(factor.events)
        }
        self._rest = [factor.idle for factor in self.factors]
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
