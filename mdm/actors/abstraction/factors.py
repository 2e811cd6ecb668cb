"""Factors: which predicates tell a component of the state, and which events one of the observation."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Literal

from mdm.actors.wiring import Wire, check_name, check_owner, index_order, named, places
from mdm.checks import check_choice
from mdm.errors import ConfigError
from mdm.logic import P

if TYPE_CHECKING:
    from mdm.actors.wiring import Names
    from mdm.models import Factor

__all__ = ["ObservationFactor", "StateFactor"]


class StateFactor:
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

    __slots__ = ("name", "on_violation", "owner", "positive", "predicates", "size", "symbols")

    def __init__(
        self,
        name: str,
        predicates: Names,
        on_violation: Literal["first", "hold", "error"] | None = None,
        *,
        owner: str | None = None,
    ) -> None:
        check_name(name, "a state factor")
        check_owner(owner, f"state factor {name!r}")
        self.owner = owner
        what = f"state factor {name!r}"
        self.name = name
        self.predicates, self.symbols = named(predicates, what, "predicate")
        if not self.predicates:
            raise ConfigError(f"state factor {name!r} needs a list of predicates, not {predicates!r}", key=name)
        if on_violation is not None:
            check_choice(on_violation, ("first", "hold", "error"), f"on_violation of state factor {name!r}", key=name)
        self.on_violation = on_violation
        self.size = max(2, len(self.predicates))
        self.positive = 1
        if self.symbols in {(0,), (1,)}:
            self.positive = int(self.symbols[0])
        elif self.symbols is not None and (order := index_order(self.symbols, self.size, what)) is not None:
            self.predicates = tuple(self.predicates[place] for place in order)
            self.symbols = tuple(range(self.size))

    @property
    def by_symbol(self) -> bool:
        """Whether the predicates were given by symbol."""
        return self.symbols is not None

    def arranged(self, factor: Factor) -> StateFactor:
        """Return it with the predicates in the order of a model's factor."""
        what = f"state factor {self.name!r}"
        new = StateFactor(self.name, self.predicates, self.on_violation, owner=self.owner)
        if self.symbols is not None:
            found = places(self.symbols, factor, what, enough=1 if len(factor) == 2 else None)
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
        owner: In a team, the agent with the sensors that tell it; by default the one of the factor's name.

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

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each of its symbols, in their order, as if each of its events were declared."""
        symbols = range(self.size) if self.symbols is None else self.symbols
        pairs = enumerate(zip(symbols, self.events, strict=True))
        return tuple(Wire(self.name, str(symbol), event, place == self.idle) for place, (symbol, event) in pairs)

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
