"""Factors: which predicates tell a component of the state, and which events one of the observation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from itertools import product
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple, Self, TypeVar

from mdm.checks import check_choice
from mdm.errors import ConfigError, ModelError
from mdm.logic import P, similar

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.models import Factor as ModelFactor, Space

Names = Sequence[str] | Mapping[str, str] | Mapping[int, str]
"""Predicates or events: in the order of a factor's symbols, or by symbol."""


class Wire(NamedTuple):
    """A symbol of a factor, and the predicate or event that stands for it.

    Attributes:
        factor: The factor's name.
        symbol: The symbol's name, or its index where no model names it.
        source: A predicate, its negation, or an event; None where nothing has to happen for the symbol.
        idle: Whether the symbol also stands for "no event".
    """

    factor: str
    symbol: str
    source: str | None
    idle: bool = False

    @property
    def name(self) -> str:
        """The symbol's name; its source where it has an index alone."""
        return self.source if self.source is not None and self.symbol.isdecimal() else self.symbol


class Factor:
    """One component of a state or an observation, whose values stand for predicates or events.

    Attributes:
        symbols: The symbols that its predicates or events were given for; None where they came in a list.
    """

    __slots__ = ("name", "owner", "symbols")

    kind: ClassVar[Literal["state factor", "observation factor"]]

    def __init__(self, name: str, owner: str | None) -> None:
        if not isinstance(name, str) or not name:
            raise ConfigError(f"the name of a{'n' if self.kind[0] == 'o' else ''} {self.kind} is a text, not {name!r}")
        self.name = name
        if owner is not None and (not isinstance(owner, str) or not owner):
            raise ConfigError(f"the owner of {self.label} is an agent's name, not {owner!r}", key="owner")
        self.owner = owner
        self.symbols: tuple[str | int, ...] | None = None

    @property
    def size(self) -> int:
        """How many values it has."""
        raise NotImplementedError

    @property
    def sources(self) -> Sequence[str | None]:
        """The predicates or events that its values stand for."""
        raise NotImplementedError

    @property
    def label(self) -> str:
        """Its kind and name, for messages."""
        return f"{self.kind} {self.name!r}"

    @property
    def by_symbol(self) -> bool:
        """Whether its predicates or events were given by symbol."""
        return self.symbols is not None

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each of its values, in their order."""
        raise NotImplementedError

    def arranged(self, factor: ModelFactor) -> Self:
        """Return it with its predicates or events in the order of a model's factor, or raise a `ConfigError`."""
        raise NotImplementedError


F = TypeVar("F", bound=Factor)


class StateFactor(Factor):
    """One component of the state: true or false (one predicate), or one of k mutually exclusive predicates.

    Args:
        name: The factor's name, as in the model where the model names its factors.
        predicates: A list in the order of the factor's values, or a mapping from the model's symbols, by name or by
            index; names without a model stand in the mapping's order. One predicate makes two values: 0 where it is
            false and 1 where it is true; in a mapping, the symbol that it is given for and the other one.
        on_violation: The value where none or several of k are true: take the ``first`` that is (where none is, as
            ``hold``), ``hold`` the last value, or ``error``. By default ``first`` for several and ``hold`` for none.
        owner: In a team, the agent with the sensors that tell it; by default the one of the factor's name.

    Example:
        >>> StateFactor("person", {"yes": "PersonIsWaiting"})
        >>> StateFactor("place", {"north": "IsInNorth", "south": "IsInSouth"}, on_violation="hold")
    """

    __slots__ = ("on_violation", "positive", "predicates")

    kind = "state factor"

    def __init__(
        self,
        name: str,
        predicates: Names,
        on_violation: Literal["first", "hold", "error"] | None = None,
        *,
        owner: str | None = None,
    ) -> None:
        super().__init__(name, owner)
        what = self.label
        self.predicates, self.symbols = _named(predicates, what, "predicate")
        if not self.predicates:
            raise ConfigError(f"{what} needs a list of predicates, not {predicates!r}", key=name)
        if on_violation is not None:
            check_choice(on_violation, ("first", "hold", "error"), f"on_violation of {what}", key=name)
        self.on_violation = on_violation
        self.positive = 1
        if self.symbols in {(0,), (1,)}:
            self.positive = int(self.symbols[0])
        elif self.symbols is not None and (order := _index_order(self.symbols, self.size, what)) is not None:
            self.predicates = tuple(self.predicates[place] for place in order)
            self.symbols = tuple(range(self.size))

    @property
    def size(self) -> int:
        """How many values it has."""
        return max(2, len(self.predicates))

    @property
    def sources(self) -> Sequence[str | None]:
        """Its predicates."""
        return self.predicates

    def arranged(self, factor: ModelFactor) -> StateFactor:
        """Return it with the predicates in the order of a model's factor."""
        what = self.label
        new = StateFactor(self.name, self.predicates, self.on_violation, owner=self.owner)
        if self.symbols is not None:
            found = _places(self.symbols, factor, what, enough=1 if len(factor) == 2 else None)
            if len(found) == 1:
                new.positive = found[0]
            else:
                new.predicates = tuple(self.predicates[found.index(place)] for place in range(len(factor)))
        if new.size != len(factor):
            raise ConfigError(f"{what} has {new.size} values, but the model's has {len(factor)}")
        new.symbols = tuple(factor.names)
        return new

    def truth(self, value: int) -> dict[str, bool]:
        """Return which of its predicates are true at a value."""
        if len(self.predicates) == 1:
            return {self.predicates[0]: value == self.positive}
        return {predicate: place == value for place, predicate in enumerate(self.predicates)}

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each of its values, in their order."""
        sources = self.predicates
        symbols = range(self.size) if self.symbols is None else self.symbols
        if len(self.predicates) == 1:
            predicate = P(self.predicates[0])
            sources = (str(predicate), str(~predicate)) if self.positive == 0 else (str(~predicate), str(predicate))
            if len(symbols) == 1:
                symbols = (f"not {symbols[0]}", symbols[0])
        return tuple(Wire(self.name, str(symbol), source) for symbol, source in zip(symbols, sources, strict=True))


class ObservationFactor(Factor):
    """One component of the observation: which of its events occurred last.

    Args:
        name: The factor's name, as in the model where the model names its factors.
        events: A list in the order of the model's symbols, or a mapping from the model's symbols, by name or by index;
            names without a model stand in the mapping's order. An event belongs to one factor only.
        idle: The symbol that stands for "no event". Of a list it is one of the events, which then need not be
            declared; of a mapping it is a symbol, which then needs no event.
        hold: Keep the last symbol where no event is new. Without ``idle`` and ``hold`` the component is missing, and
            the belief update sums over it.
        owner: In a team, the agent with the sensors that tell it; by default the one of the factor's name.

    Example:
        >>> ObservationFactor("camera", {"closed": "SawClosed", "open": "SawOpen"}, idle="nothing")
    """

    __slots__ = ("events", "hold", "idle")

    kind = "observation factor"

    def __init__(
        self,
        name: str,
        events: Names,
        *,
        idle: str | int | None = None,
        hold: bool = False,
        owner: str | None = None,
    ) -> None:
        super().__init__(name, owner)
        what = self.label
        given, self.symbols = _named(events, what, "event")
        if self.symbols and idle is not None and type(idle) is not type(self.symbols[0]):
            raise ConfigError(f"give the idle symbol {idle!r} of {what} by name or index, as the others", key=name)
        self.events: tuple[str | None, ...] = given
        if self.symbols is not None and idle is not None and idle not in self.symbols:
            self.symbols, self.events = (*self.symbols, idle), (*given, None)
        if len(self.events) < 2:
            raise ConfigError(f"{what} needs at least two events, not {events!r}", key=name)
        known: tuple[str | int, ...] = given if self.symbols is None else self.symbols
        if idle is not None and idle not in known:
            raise ConfigError(f"the idle symbol {idle!r} of {what} is not one of {', '.join(given)}", key=name)
        if idle is not None and hold:
            raise ConfigError(f"{what} can take its idle symbol or hold the last one, not both", key=name)
        if self.symbols is not None and (order := _index_order(self.symbols, self.size, what)) is not None:
            self.events = tuple(self.events[place] for place in order)
            self.symbols = known = tuple(range(self.size))
        self.idle = None if idle is None else known.index(idle)
        self.hold = hold

    @property
    def size(self) -> int:
        """How many symbols it has."""
        return len(self.events)

    @property
    def sources(self) -> Sequence[str | None]:
        """Its events."""
        return self.events

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each of its symbols, in their order, as if each of its events were declared."""
        symbols = range(self.size) if self.symbols is None else self.symbols
        pairs = enumerate(zip(symbols, self.events, strict=True))
        return tuple(Wire(self.name, str(symbol), event, place == self.idle) for place, (symbol, event) in pairs)

    def arranged(self, factor: ModelFactor) -> ObservationFactor:
        """Return it with the events in the order of a model's factor."""
        what = self.label
        new = copy(self)
        if self.symbols is not None:
            found = _places(self.symbols, factor, what)
            new.events = tuple(self.events[found.index(place)] for place in range(len(factor)))
            new.idle = None if self.idle is None else found[self.idle]
        if new.size != len(factor):
            raise ConfigError(f"{what} has {new.size} symbols, but the model's has {len(factor)}")
        new.symbols = tuple(factor.names)
        return new


def arrange(
    factors: Iterable[F], space: Space | None, kind: Literal["state factor", "observation factor"]
) -> tuple[tuple[F, ...], list[ConfigError]]:
    """Put factors, and the predicates or events of their symbols, in a model's order.

    Where the model names its factors they are matched by name, else by order. Where it has one factor only, which it
    does not name, several may make up its symbols together. Each of the model's factors is needed: a joint index of
    some of them would be that of another symbol of the model.

    Args:
        factors: As the user gave them.
        space: The model's space; None without a model, where everything is in order.
        kind: Their name in messages.

    Returns:
        The factors, as far as they could be arranged, and the problems. The key of a problem is a factor's name, or
        None.
    """
    given = tuple(factors)
    names = [factor.name for factor in given]
    problems = [
        ConfigError(f"two {kind}s are called {name!r}", key=name)
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    if space is None or problems:
        return given, problems
    models = {factor.name: factor for factor in space.factors}
    if space.is_named or set(names) == models.keys():
        problems = list(_unmatched(names, models, kind))
        order = list(models)
        pairs = [(factor, models[factor.name]) for factor in given if factor.name in models]
        pairs.sort(key=lambda pair: order.index(pair[1].name))
    elif len(given) == len(models):
        pairs = list(zip(given, space.factors, strict=True))
    else:
        return given, list(_mismatches(given, space, kind))
    arranged: list[F] = []
    for factor, model in pairs:
        try:
            arranged.append(factor.arranged(model))
        except ConfigError as error:
            problems.append(ConfigError(error.message, key=factor.name))
    return (given if problems else tuple(arranged)), problems


def combined(factors: Sequence[Factor], space: Space | None) -> Iterator[tuple[str, str]]:
    """Yield each symbol that several factors make up by their order alone, and what has to hold for it.

    Nothing where the model names its factors, or divides its symbols itself.
    """
    if space is None or not len(space.factors) == 1 < len(factors):
        return
    if math.prod(factor.size for factor in factors) == len(space):
        each = product(*([wire.source or f"no {wire.factor}" for wire in factor.wires()] for factor in factors))
        yield from ((name, " and ".join(sources)) for name, sources in zip(space.names, each, strict=True))


def _named(names: Names, what: str, of: str) -> tuple[tuple[str, ...], tuple[str | int, ...] | None]:
    """Return names of predicates or events, and the symbols that they are given for, if any.

    Args:
        names: As given.
        what: The factor, for messages.
        of: The kind that is named: ``predicate`` or ``event``.
    """
    symbols: tuple[str | int, ...] | None = (*names,) if isinstance(names, Mapping) else None
    values = tuple(names.values()) if isinstance(names, Mapping) else names
    listed = isinstance(values, Sequence) and not isinstance(values, str)
    keys = symbols or ()
    alike = all(isinstance(key, str) for key in keys) or all(type(key) is int for key in keys)
    if not listed or not all(isinstance(value, str) for value in values) or not alike:
        raise ConfigError(
            f"{what} needs a list of {of}s, or a mapping from symbols to {of}s, by name or by index but not both, "
            f"not {names!r}"
        )
    if len(set(values)) != len(values):
        raise ConfigError(f"{what} names {'an' if of == 'event' else 'a'} {of} twice: {', '.join(values)}")
    return tuple(values), symbols


def _index_order(symbols: Sequence[str | int], size: int, what: str) -> list[int] | None:
    """Return where each index from 0 stands among symbols that are indices; None where they are names.

    Raises:
        ConfigError: If one is missing or is no index of ``size`` values.
    """
    if all(isinstance(symbol, str) for symbol in symbols):
        return None
    if sorted(symbols) != list(range(size)):
        raise ConfigError(
            f"{what} has the indices 0 to {size - 1}, each of them once, not {', '.join(map(str, symbols))}"
        )
    return [symbols.index(place) for place in range(size)]


def _places(symbols: Iterable[str | int], factor: ModelFactor, what: str, *, enough: int | None = None) -> list[int]:
    """Return the place of each symbol among a model's.

    Args:
        symbols: Names or indices.
        factor: The model's factor.
        what: The ensemble's factor, for messages.
        enough: How many symbols are enough; all by default.

    Raises:
        ConfigError: If one is unknown or given twice, or if one of the model's is missing.
    """
    found: list[int] = []
    wrong: list[str] = []
    for symbol in symbols:
        try:
            place = factor.index(symbol)
        except ModelError as error:
            wrong.append(f"the model's {error}")
            continue
        if place in found:
            wrong.append(f"the symbol {factor.names[place]!r} is given twice")
        found.append(place)
    missing = [name for place, name in enumerate(factor.names) if place not in found]
    if missing and (enough is None or len(found) < enough):
        wrong.append(f"nothing stands for the symbol {' or '.join(map(repr, missing))}")
    if wrong:
        raise ConfigError(f"{what}: {'; '.join(wrong)}")
    return found


def _unmatched(given: Sequence[str], known: Iterable[str], kind: str) -> Iterator[ConfigError]:
    """Yield the factors that the model does not have, and those of the model that are missing."""
    for name in given:
        if name not in known:
            hint = similar(name, known) or f"; it has {', '.join(known)}"
            yield ConfigError(f"the model has no {kind} {name!r}{hint}", key=name)
    if all(name in known for name in given):  # else a name that is wrong may be meant for one that is missing
        source = "predicates" if kind == "state factor" else "events"
        for name in known:
            if name not in given:
                whole = "a state" if kind == "state factor" else "an observation"
                yield ConfigError(
                    f"the model's {kind} {name!r} has no {source}: give it some, for {whole} is made of all factors",
                    key=name,
                )


def _mismatches(factors: Sequence[Factor], space: Space, kind: str) -> Iterator[ConfigError]:
    """Yield why factors do not make up the symbols of a model that does not name its factors."""
    if len(space.factors) > 1 or math.prod(factor.size for factor in factors) != len(space):
        ours = ", ".join(f"{factor.name}: {factor.size}" for factor in factors)
        model = ", ".join(f"{factor.name}: {len(factor)}" for factor in space.factors)
        yield ConfigError(f"{len(factors)} {kind}s ({ours}) do not make up the model's {len(space)} symbols ({model})")
        return
    of = "a predicate" if kind == "state factor" else "an event"
    for factor in factors:
        if factor.by_symbol:
            yield ConfigError(
                f"{kind} {factor.name!r} goes by symbol, but the model has one factor of {len(space)} symbols and none "
                f"of that name: give lists, or one factor with {of} for each of the {len(space)}, defined by a formula",
                key=factor.name,
            )
