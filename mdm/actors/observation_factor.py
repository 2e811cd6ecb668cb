"""Observation factors: which events tell a component of the observation."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

from mdm.actors.wiring import check_name, check_owner, index_order, named, places
from mdm.errors import ConfigError

if TYPE_CHECKING:
    from mdm.actors.wiring import Names
    from mdm.models import Factor

__all__ = ["ObservationFactor"]


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
