"""Oddities of a TOML file as it is written: what is allowed, and hardly meant."""

from __future__ import annotations

import tomllib
from contextlib import suppress
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.errors import Error
from mdm.logic import parse

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mdm.logic import Formula

__all__ = ["oddities"]

_LONG = {
    "period": 60,
    "deadline": 60,
    "max_age": 300,
    "grace": 300,
    "lease": 300,
    "held_for": 3600,
    "pause": 3600,
    "safe_timeout": 3600,
    "timeout": 10_000,
}
"""Seconds from which a time is more likely to be in milliseconds."""
_MOST = 10
"""Inputs of two formulas up to which all their values are tried."""


def oddities(file: str) -> Iterator[str]:
    """Yield a sentence on each oddity of a file without problems."""
    document = tomllib.loads(Path(file).read_text(encoding="utf-8-sig"))
    ensembles = document.get("ensembles", {})
    yield from _long_times(document, "")
    named = {"predicates and events": [*document.get("predicates", {}), *document.get("events", {})]}
    named["ensembles"] = [*ensembles]
    named |= {f"actions of {name!r}": [*table["actions"]] for name, table in ensembles.items()}
    for what, names in named.items():
        yield from _differing_by_case(what, names)
    definitions = _definitions(document)
    yield from _unused(document, definitions)
    for name, table in ensembles.items():
        yield from _overlapping(name, table.get("states", {}), definitions)
        yield from _bound_twice(name, table["actions"], ensembles)


def _long_times(table: Mapping[str, Any], key: str) -> Iterator[str]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _long_times(value, f"{key}{name}.")
        elif name in _LONG and isinstance(value, int | float) and value >= _LONG[name]:
            told = f"{value:g} are seconds, {value / 60:.3g} min: {value / 1000:g} would be as many milliseconds"
            yield f"{key}{name} = {told}"


def _differing_by_case(what: str, names: list[str]) -> Iterator[str]:
    alike: dict[str, list[str]] = {}
    for name in names:
        alike.setdefault(name.casefold(), []).append(name)
    for each in alike.values():
        if len(each) > 1:
            yield f"{what}: {' and '.join(map(repr, each))} differ by capital letters alone"


def _definitions(document: Mapping[str, Any]) -> dict[str, tuple[Formula, ...]]:
    """Return the formulas by which predicates and events are made; none for what code tells."""
    found = {}
    for name, given in [*document.get("predicates", {}).items(), *document.get("events", {}).items()]:
        table = {"formula": given} if isinstance(given, str) else given
        found[name] = tuple(parse(table[key]) for key in ("formula", "set", "reset") if key in table)
    return found


def _unused(document: Mapping[str, Any], definitions: Mapping[str, tuple[Formula, ...]]) -> Iterator[str]:
    used = {name for formulas in definitions.values() for formula in formulas for name in formula.names}
    for table in document.get("ensembles", {}).values():
        used |= {*_texts(table.get("states", {})), *_texts(table.get("observations", {}))}
    used |= {name.rpartition("/")[2] for name in used}
    unused = [name for name, formulas in definitions.items() if not formulas and name not in used]
    if unused:
        yield f"nothing in this file uses {', '.join(map(repr, unused))}: what code tells there leads to no decision"


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _texts(inner)


def _overlapping(
    ensemble: str, factors: Mapping[str, Any], definitions: Mapping[str, tuple[Formula, ...]]
) -> Iterator[str]:
    """Yield pairs of predicates of a state factor that are true together, as their formulas have it."""
    for factor, given in factors.items():
        table = given.get("predicates", given) if isinstance(given, dict) else given
        names = [*(table.values() if isinstance(table, dict) else table)]
        for pair in combinations(names, 2):
            if any(definitions.get(name) for name in pair):
                with suppress(Error):
                    if (where := _together(*pair, definitions)) is not None:
                        yield (
                            f"ensemble {ensemble!r}: {pair[0]!r} and {pair[1]!r} of the state factor {factor!r} are "
                            f"both true where {where}"
                        )


def _together(one: str, other: str, definitions: Mapping[str, tuple[Formula, ...]]) -> str | None:
    """Return where two predicates are both true: one follows from the other, or what they share makes them so."""
    inputs = _inputs(one, definitions), _inputs(other, definitions)
    shared, all_of = inputs[0] & inputs[1], sorted(inputs[0] | inputs[1])
    if not shared or len(all_of) > _MOST:
        return None
    rows = [dict(zip(all_of, values, strict=True)) for values in product((False, True), repeat=len(all_of))]
    held = [(row, _value(one, row, definitions), _value(other, row, definitions)) for row in rows]
    both = [row for row, first, second in held if first and second]
    follows = all(second for _, first, second in held if first) or all(first for _, first, second in held if second)
    found = both if follows else [row for row in both if not any(row[name] for name in all_of if name not in shared)]
    if not found:
        return None
    true = [name for name, value in found[0].items() if value]
    return f"{' and '.join(true)} {'is' if len(true) == 1 else 'are'}" if true else f"none of {', '.join(all_of)} is"


def _inputs(name: str, definitions: Mapping[str, tuple[Formula, ...]]) -> set[str]:
    formulas = definitions.get(name, ())
    if len(formulas) != 1:
        return {name}  # told by code, or a latch
    return {inner for used in formulas[0].names for inner in _inputs(used, definitions)}


def _value(name: str, values: Mapping[str, bool], definitions: Mapping[str, tuple[Formula, ...]]) -> bool | None:
    if name in values:
        return values[name]
    (formula,) = definitions[name]
    return formula.evaluate({used: _value(used, values, definitions) for used in formula.names})


def _bound_twice(name: str, actions: Mapping[str, Any], ensembles: Mapping[str, Any]) -> Iterator[str]:
    """Yield ensembles that two actions start, while another one is started by none, and so decides by itself."""
    below: dict[str, list[str]] = {}
    for action, given in actions.items():
        if isinstance(given, dict) and isinstance(given.get("ensemble"), str):
            below.setdefault(given["ensemble"], []).append(action)
    everywhere = {text for table in ensembles.values() for text in _texts(table["actions"])}
    free = [repr(other) for other in ensembles if other != name and other not in everywhere]
    for child, bound in below.items():
        if len(bound) > 1:
            rest = f"; no action starts {' or '.join(free)}, which decides by itself" if free else ""
            yield f"ensemble {name!r}: the actions {' and '.join(bound)} start the same ensemble {child!r}{rest}"
