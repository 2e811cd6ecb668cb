"""Oddities of a TOML file as it is written: what is allowed, and hardly meant."""

from __future__ import annotations

import tomllib
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.logic import P, parse
from mdm.texts import texts_in

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.logic import Formula

    Definitions = dict[str, tuple[Formula, ...]]

__all__ = ["oddities"]

_LONG = {"period": 60, "deadline": 60, "max_age": 300, "grace": 300, "lease": 300, "held_for": 3600, "pause": 3600}
_LONG |= {"safe_timeout": 3600, "timeout": 10_000}
"""Seconds from which a time is more likely to be in milliseconds."""
_MOST = 10
"""Inputs of two formulas up to which all their values are tried."""


def oddities(file: str) -> Iterator[str]:
    """Yield a sentence on each oddity of a file without problems."""
    document = tomllib.loads(Path(file).read_text(encoding="utf-8-sig"))
    ensembles = document["ensembles"]
    yield from _long_times(document, "")
    definitions: Definitions = {}
    for name, given in [*document.get("predicates", {}).items(), *document.get("events", {}).items()]:
        table = {"formula": given} if isinstance(given, str) else given
        definitions[name] = tuple(parse(table[key]) for key in ("formula", "set", "reset") if key in table)
    named = {"predicates and events": definitions, "ensembles": ensembles}
    named |= {f"actions of {name!r}": table["actions"] for name, table in ensembles.items()}
    for what, names in named.items():
        spelt: dict[str, str] = {}
        for name in names:
            if (other := spelt.setdefault(name.casefold(), name)) != name:
                yield f"{what}: {other!r} and {name!r} differ by capital letters alone"
    used = {name for formulas in definitions.values() for formula in formulas for name in formula.names}
    used |= {*texts_in([table.get(kind) for table in ensembles.values() for kind in ("states", "observations")])}
    used |= {name.rpartition("/")[2] for name in used}
    if unused := [name for name, formulas in definitions.items() if not formulas and name not in used]:
        yield f"nothing in this file uses {', '.join(map(repr, unused))}: what code tells there leads to no decision"
    for name, table in ensembles.items():
        for factor, given in table.get("states", {}).items():
            predicates = given.get("predicates", given) if isinstance(given, dict) else given
            for pair in combinations(predicates.values() if isinstance(predicates, dict) else predicates, 2):
                if any(map(definitions.get, pair)) and (where := _together(*pair, definitions)) is not None:
                    both = f"{pair[0]!r} and {pair[1]!r} of the state factor {factor!r} are both true where {where}"
                    yield f"ensemble {name!r}: {both}"
        yield from _bound_twice(name, ensembles)


def _long_times(table: dict[str, Any], key: str) -> Iterator[str]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _long_times(value, f"{key}{name}.")
        elif name in _LONG and isinstance(value, int | float) and value >= _LONG[name]:
            told = f"{value:g} are seconds, {value / 60:.3g} min: {value / 1000:g} would be as many milliseconds"
            yield f"{key}{name} = {told}"


def _together(one: str, other: str, definitions: Definitions) -> str | None:
    """Return where two predicates are both true: one follows from the other, or what they share makes them so."""
    first, second = (_of_inputs(P(name), definitions) for name in (one, other))
    shared, inputs = first.names & second.names, sorted(first.names | second.names)
    if not shared or len(inputs) > _MOST:
        return None
    rows = [dict(zip(inputs, values, strict=True)) for values in product((False, True), repeat=len(inputs))]
    held = [(row, first.evaluate(row), second.evaluate(row)) for row in rows]
    found = [row for row, a, b in held if a and b]
    if any(a and not b for _, a, b in held) and any(b and not a for _, a, b in held):
        found = [row for row in found if not any(row[name] for name in inputs if name not in shared)]
    if not found:
        return None
    true = [name for name in inputs if found[0][name]]
    return f"{' and '.join(true)} {'is' if len(true) == 1 else 'are'}" if true else f"none of {', '.join(inputs)} is"


def _of_inputs(formula: Formula, definitions: Definitions) -> Formula:
    """Return a formula of what code tells and of latches alone."""
    if isinstance(formula, P):
        made = definitions.get(formula.name, ())
        return _of_inputs(made[0], definitions) if len(made) == 1 else formula
    return type(formula)(*(_of_inputs(part, definitions) for part in formula.parts)) if formula.parts else formula


def _bound_twice(name: str, ensembles: dict[str, Any]) -> Iterator[str]:
    """Yield ensembles that two actions start, while another one is started by none, and so decides by itself."""
    below: dict[str, list[str]] = {}
    for action, given in ensembles[name]["actions"].items():
        if isinstance(given, dict) and isinstance(given.get("ensemble"), str):
            below.setdefault(given["ensemble"], []).append(action)
    started = {text for table in ensembles.values() for text in texts_in(table["actions"])}
    free = " or ".join(repr(other) for other in ensembles if other != name and other not in started)
    rest = f"; no action starts {free}, which decides by itself" if free else ""
    for child, bound in below.items():
        if len(bound) > 1:
            yield f"ensemble {name!r}: the actions {' and '.join(bound)} start the same ensemble {child!r}{rest}"
