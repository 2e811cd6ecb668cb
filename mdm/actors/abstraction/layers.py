"""The state and the observation layer: from predicates and events to factored joint states and observations."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Generic

from mdm.actors.abstraction.factors import F, ObservationFactor, StateFactor, arrange
from mdm.actors.layer import Layer
from mdm.errors import ConfigError, Error
from mdm.logic import similar
from mdm.logic.network import MOST, Memory
from mdm.messages import EventUpdate, Observation, PredicateUpdate, State

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors.abstraction.factors import Wire
    from mdm.actors.predicates.predicate_manager import PredicateManager
    from mdm.models import Space

_FEW = 8
_Joint = tuple[int, tuple[int | None, ...]]


class FactorLayer(Layer, Generic[F]):
    """A layer that makes up symbols of a model from factors.

    Attributes:
        factors: All of the model's factors, in its order.
        own: Those that it covers: all, but of an agent of a team.
    """

    section: ClassVar[str]
    factor: ClassVar[type[StateFactor | ObservationFactor]]

    def __init__(self, factors: Iterable[F], predicates: PredicateManager, space: Space | None, name: str) -> None:
        super().__init__(name)
        self.factors, self._misplaced = arrange(factors, space, self.factor.kind)
        self.predicates = predicates
        self.space = space
        self.own = self.factors
        self._covers: frozenset[str] | None = None
        predicates.declared.use(*self.sources())

    @property
    def key(self) -> str:
        """Where the factors stand in a configuration."""
        return f"ensembles.{self.owner.name}.{self.section}"

    def cover(self, names: Iterable[str]) -> None:
        """Tell nothing of factors but these, and tell it on ``own_…``: a team puts its agents' parts together."""
        self._covers = frozenset(names)
        self.own = tuple(factor for factor in self.factors if factor.name in self._covers)

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each value of each factor."""
        return tuple(wire for factor in self.factors for wire in factor.wires())

    def sources(self) -> list[str]:
        """Return the predicates or events of the factors that it covers."""
        return [name for factor in self.own for name in factor.sources if name is not None]

    def inputs(self) -> frozenset[str]:
        """Return the names of all that these depend on, themselves included."""
        return frozenset(found for name in self.sources() for found in self.predicates.declared.inputs_of(name))

    def misplaced(self) -> Iterator[ConfigError]:
        """Yield the faults of the factors against the model."""
        for problem in self._misplaced:
            yield ConfigError(problem.message, key=".".join(filter(None, (self.key, problem.key))))


class _Value:
    """The known part of a factor: the truth of its predicates, as bit masks."""

    __slots__ = ("binary", "factor", "negative", "position", "positive", "stride", "true", "unknown", "violated")

    def __init__(self, factor: StateFactor, position: int, stride: int) -> None:
        self.factor = factor
        self.binary = len(factor.predicates) == 1
        self.positive = factor.positive
        self.negative = 1 - factor.positive
        self.position = position
        self.stride = stride
        self.true = 0
        self.unknown = (1 << len(factor.predicates)) - 1
        self.violated = 0

    def is_told_by(self, digit: int | None) -> bool:
        """Whether a factor's digit says all that is known of it."""
        return self.binary or (self.true == 1 << (digit or 0) and not self.unknown)


class StateLayer(FactorLayer[StateFactor]):
    """Publishes the joint `State` on ``state`` whenever it changes, once every factor is known.

    When a known factor becomes unknown (a sensor's value grew too old), a state without an index says so. A layer that
    covers an agent's own factors alone publishes on ``own_state`` the known values of these, whenever one changes.

    Args:
        factors: All of the model's factors; by name where the model names them, else in the model's order,
            first the most significant.
        predicates: The predicate manager.
        space: The model's state space, to arrange the factors by and to check them against.
    """

    section = "states"
    factor = StateFactor

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = ("_digits", "_index", "_known", "_moves", "_published", "_slots")

    def __init__(
        self,
        factors: Iterable[StateFactor],
        predicates: PredicateManager,
        *,
        space: Space | None = None,
        name: str = "state",
    ) -> None:
        super().__init__(factors, predicates, space, name)
        self.violations = 0
        self._part: tuple[int | None, ...] = ()
        self.joint: tuple[int | None, ...] = ()
        self._values: tuple[_Value, ...] = ()
        self._slots: dict[str, tuple[tuple[_Value, int], ...]] = {}
        self._digits: tuple[int | None, ...] = ()
        # By the index, and predicates that rise and fall: index and digits that they lead to. It is looked at where the
        # digits say all that is known: of each factor of several predicates one is true, and the others are false.
        self._memory: Memory[tuple[object, ...], _Joint] | None = None
        self._moves: Memory[tuple[object, ...], _Joint] | None = None
        self._index = 0
        self._known = False

    def unknown(self) -> tuple[str, ...]:
        """Return the predicates that keep the state unknown, sorted: of derived ones, the inputs that make them so."""
        values = self.predicates.values()
        names: set[str] = set()
        others: set[str] = set()
        for factor, digit in zip(self.factors, self.joint or self._digits, strict=False):
            if digit is None and factor not in self.own:
                others.add(factor.name if factor.owner is None else f"{factor.name} (of {factor.owner})")
            elif digit is None:
                found = [name for name in factor.predicates if values.get(name) is None]
                names.update(found or factor.predicates)
        declared = self.predicates.declared
        inputs = {one for name in names for one in declared.inputs_of(name) if values.get(one, False) is None}
        given = {name for name in inputs if not declared.derived(name)}
        return (*sorted(given or names), *sorted(others))

    def problems(self) -> Iterator[ConfigError]:
        """Yield the faults of the factors: against the predicates declared and against the model."""
        for factor in self.own:
            for predicate in factor.predicates:
                declared = self.predicates.declared
                if declared.knows(predicate) != "predicate":
                    known = [name for name, kind in declared.names.items() if kind == "predicate"]
                    yield ConfigError(
                        f"state factor {factor.name!r} uses {predicate!r}, which is no declared predicate"
                        f"{similar(predicate, known)}",
                        key=f"{self.key}.{factor.name}",
                    )
        yield from self.misplaced()

    def on_start(self) -> None:
        """Take every predicate's value, and each change from now on."""
        for problem in self.problems():
            raise problem
        self._published = self.owner.channel("state" if self._covers is None else "own_state", State, retain=True)
        self._part = ()
        self._index = 0
        self._known = False
        values: list[_Value] = []
        stride = 1
        for position, factor in reversed(list(enumerate(self.factors))):
            values.insert(0, _Value(factor, position, stride))
            stride *= factor.size
        self._values = tuple(values)
        self._digits = (None,) * len(values)
        slots: dict[str, list[tuple[_Value, int]]] = {}
        for value in self._values:
            if value.factor not in self.own:
                continue
            for position, predicate in enumerate(value.factor.predicates):
                slots.setdefault(predicate, []).append((value, 1 << position))
        self._slots = {predicate: tuple(places) for predicate, places in slots.items()}
        self._moves, self._memory = None, Memory() if stride <= MOST else None
        self.subscribe(self.predicates.updates, self._update, topics=self._slots)
        now = self.predicates.values()
        self._update(
            PredicateUpdate(
                self.runtime.now(),
                0,
                tuple(name for name in self._slots if now[name] is True),
                tuple(name for name in self._slots if now[name] is False),
                (),
            )
        )

    def _update(self, update: PredicateUpdate) -> None:  # noqa: C901 - hot path, no calls
        """Hot path: looks up what a recurring change makes of a joint state that says all that is known."""
        moves, index = self._moves, self._index
        if moves is not None and not update.unknown:
            joint = moves.get((index, update.rising, update.falling))
            if joint is not None:
                if joint[0] != index:
                    self._index, self._digits = joint
                    self._published.emit_last(State(update.time, *joint))
                return
        digits, several, found = [*self._digits], list[_Value](), bool(update.unknown)
        if moves is not None:
            self._moves = None
            for value, digit in zip(self._values, digits, strict=True):  # which does not follow what is looked up
                value.true = 1 << (digit or 0)
        for names, rises in ((update.rising, True), (update.falling, False)):
            for name in names:
                for value, bit in self._slots.get(name, ()):
                    found = True
                    if not value.binary:
                        value.true = value.true | bit if rises else value.true & ~bit
                        value.unknown &= ~bit
                        several.append(value)
                        continue
                    old, new = digits[value.position], value.positive if rises else value.negative
                    if old != new:
                        digits[value.position] = new
                        index += (new - (old or 0)) * value.stride
        for value in (*several, *self._forget(update.unknown)):
            digit, old = self._evaluate(value, update.time), digits[value.position]
            if digit != old:
                digits[value.position] = digit
                index += ((digit or 0) - (old or 0)) * value.stride
        if not found:
            self._moves = moves
            return
        self._digits = tuple(digits)
        if None in digits:
            self._lost(update.time)
            return
        before, known, self._index, self._known = self._index, self._known, index, True
        if self._memory is not None and all(map(_Value.is_told_by, self._values, digits)):
            self._moves = self._memory
            if moves is not None:
                moves.keep((before, update.rising, update.falling), (index, self._digits))
        if index != before or not known:
            self._published.emit_last(State(update.time, index, self._digits))

    def _forget(self, names: tuple[str, ...]) -> list[_Value]:
        """Take predicates as unknown; return the factors that this concerns."""
        places = [place for name in names for place in self._slots.get(name, ())]
        for value, bit in places:
            value.true &= ~bit
            value.unknown |= bit
        return [value for value, _ in places]

    def _evaluate(self, value: _Value, time: int) -> int | None:
        true, factor = value.true, value.factor
        if value.binary:  # and it has become unknown
            return None
        if true and not true & (true - 1):
            value.violated = 0
            return true.bit_length() - 1
        if not true and value.unknown:
            value.violated = 0
            return None
        state = true | 1 << len(factor.predicates)
        if value.violated != state:
            value.violated = state
            self._violation(factor, true, time)
        if true and factor.on_violation in {None, "first"}:
            return (true & -true).bit_length() - 1
        return self._digits[value.position]

    def _violation(self, factor: StateFactor, true: int, time: int) -> None:
        self.violations += 1
        names = [name for position, name in enumerate(factor.predicates) if true >> position & 1]
        what = f"{' and '.join(names)} are true at once" if names else f"none of {', '.join(factor.predicates)} is true"
        text = f"state factor {factor.name!r}: {what}, though exactly one should be"
        if factor.on_violation == "error":
            raise Error(text)
        took = f"took {names[0]}" if names and factor.on_violation != "hold" else "held the last value"
        self.report("violation", f"{text}; {took}", time=time)

    def _lost(self, time: int) -> None:
        # The index goes on counting unknown factors as 0, so that it can be kept up by differences.
        self._index = sum((digit or 0) * value.stride for digit, value in zip(self._digits, self._values, strict=True))
        if self._covers is not None:
            self._known = False
            part, self._part = self._part, self._digits
            if part != self._part:
                self._published.derive(State(time, None, self._part))
        elif self._known:
            self._known = False
            self._published.derive(State(time, None, self._digits))


class ObservationLayer(FactorLayer[ObservationFactor]):
    """Publishes the joint `Observation` on ``observation`` whenever an event of one of its factors occurs.

    A layer that covers an agent's own factors alone publishes on ``own_observation``; of others it says nothing.

    Args:
        factors: By name where the model names its factors or agents, else in the model's order, first the most
            significant.
        predicates: The predicate manager of these events.
        space: The model's observation space, to arrange the factors by and to check them against.
    """

    section = "observations"
    factor = ObservationFactor

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = ("_known", "_published")

    def __init__(
        self,
        factors: Iterable[ObservationFactor],
        predicates: PredicateManager,
        *,
        space: Space | None = None,
        name: str = "observation",
    ) -> None:
        super().__init__(factors, predicates, space, name)
        self.conflicts = 0
        self._places: dict[str, tuple[int, int]] = {}
        self._rest: list[int | None] = []
        self._strides: tuple[int, ...] = ()
        self._holds = any(factor.hold for factor in self.factors)
        self._known: Memory[tuple[str, ...], tuple[int | None, tuple[int | None, ...], tuple[bool, ...]]] = Memory()

    def _is_declared(self, event: str | None) -> bool:
        return event is not None and self.predicates.declared.knows(event) == "event"

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each symbol of each factor; without an event that is not declared."""
        return tuple(wire if self._is_declared(wire.source) else wire._replace(source=None) for wire in super().wires())

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
        yield from self.misplaced()

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
