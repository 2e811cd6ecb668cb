"""Wiring: which predicates and events stand for which symbols of a model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, Self, TypeVar

from mdm.errors import ConfigError, ModelError
from mdm.logic import similar

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.models import Factor, Space

__all__ = [
    "Names",
    "Wire",
    "Wired",
    "arrange",
    "check_name",
    "check_owner",
    "combined",
    "index_order",
    "named",
    "places",
]

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


class Wired(Protocol):
    """A factor of an ensemble."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def size(self) -> int:
        """How many values it has."""

    @property
    def by_symbol(self) -> bool:
        """Whether its predicates or events were given by symbol."""

    def wires(self) -> tuple[Wire, ...]:
        """Return the wire of each of its values, in their order."""

    def arranged(self, factor: Factor) -> Self:
        """Return it with its predicates or events in the order of a model's factor, or raise a `ConfigError`."""


W = TypeVar("W", bound=Wired)


def named(names: Names, what: str, of: str) -> tuple[tuple[str, ...], tuple[str | int, ...] | None]:
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


def check_name(name: object, kind: str) -> None:
    """Refuse a value that is no name of a factor.

    Raises:
        ConfigError: If it is no text, or is empty.
    """
    if not isinstance(name, str) or not name:
        raise ConfigError(f"the name of {kind} is a text, not {name!r}")


def check_owner(owner: object, what: str) -> None:
    """Refuse a value that is no name of a factor's owner.

    Raises:
        ConfigError: If it is neither None nor a text that is not empty.
    """
    if owner is not None and (not isinstance(owner, str) or not owner):
        raise ConfigError(f"the owner of {what} is an agent's name, not {owner!r}", key="owner")


def index_order(symbols: Sequence[str | int], size: int, what: str) -> list[int] | None:
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


def places(symbols: Iterable[str | int], factor: Factor, what: str, *, enough: int | None = None) -> list[int]:
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


def arrange(
    factors: Iterable[W], space: Space | None, kind: Literal["state factor", "observation factor"]
) -> tuple[tuple[W, ...], list[ConfigError]]:
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
    arranged: list[W] = []
    for factor, model in pairs:
        try:
            arranged.append(factor.arranged(model))
        except ConfigError as error:
            problems.append(ConfigError(error.message, key=factor.name))
    return (given if problems else tuple(arranged)), problems


def combined(factors: Sequence[Wired], space: Space | None) -> Iterator[tuple[str, str]]:
    """Yield each symbol that several factors make up by their order alone, and what has to hold for it.

    Nothing where the model names its factors, or divides its symbols itself.
    """
    if space is None or not len(space.factors) == 1 < len(factors):
        return
    if math.prod(factor.size for factor in factors) == len(space):
        each = product(*([wire.source or f"no {wire.factor}" for wire in factor.wires()] for factor in factors))
        yield from ((name, " and ".join(sources)) for name, sources in zip(space.names, each, strict=True))


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


def _mismatches(factors: Sequence[Wired], space: Space, kind: str) -> Iterator[ConfigError]:
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
