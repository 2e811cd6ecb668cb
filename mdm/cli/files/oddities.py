"""Oddities of a TOML file, or of ensembles made in Python: allowed, and hardly meant.

They are of four kinds. Each may be meant: an oddity is a note, and no problem.

- *Units*: a time in seconds that is as long as one in milliseconds would be, or shorter than anything takes; a rate
  that would do as a period, or the other way round.
- *Overlaps*: two values of a state factor that some input makes true at once, by their formulas or by their thresholds;
  numbers for which no threshold of a factor holds.
- *Unused*: a sensor or an event that no formula, no factor and nothing else in the file names; an action that the
  policy never chooses.
- *Orphans*: an ensemble that decides by itself, while two actions of another one start the same; names that differ by
  capital letters alone.
"""

from __future__ import annotations

import importlib.util
import tomllib
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.files.positions import Positions
from mdm.cli.files.shields import of_shields
from mdm.logic import Monitor, P, parse, parse_threshold
from mdm.texts import texts_in

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors import Ensemble
    from mdm.logic import Formula, Threshold

    Definitions = dict[str, tuple[Formula, ...]]
    Sensors = dict[tuple[str, str], dict[str, Any]]
    Odd = tuple[tuple[str, ...], str]
    """The keys of a place in the file, and a sentence on it."""

_LONG = {"period": 60, "deadline": 60, "max_age": 300, "grace": 300, "lease": 300, "held_for": 3600, "pause": 3600}
_LONG |= {"safe_timeout": 3600, "timeout": 10_000}
"""Seconds from which a time is more likely to be in milliseconds."""
_BRIEF = 0.001
"""Seconds below which a time is hardly meant."""
_FAST, _SLOW = 1000, 0.1
"""Decisions a second above which a rate, and below which a period, is likely to be meant otherwise."""
_INPUTS = 10
"""Inputs of two formulas up to which all their values are tried."""


def oddities(file: str, ensembles: Iterable[Ensemble], *, imports: bool) -> Iterator[str]:
    """Yield a sentence on each oddity of a file without problems, with its line and column.

    Args:
        file: The file.
        ensembles: Those that were built from it.
        imports: Whether functions were imported.
    """
    text = Path(file).read_text(encoding="utf-8-sig")
    document = tomllib.loads(text)
    positions = Positions(text)
    ros: Iterable[Odd] = _of_ros(document, imports=imports)
    built = list(ensembles)
    for keys, told in (*ros, *of_document(document), *of_ensembles(built), *of_shields(built)):
        line, column = positions.of(keys)
        yield f"{file}:{line}:{column}: {told}"


def of_ensembles(ensembles: Iterable[Ensemble]) -> Iterator[Odd]:
    """Yield oddities of ensembles as they were built: of their declarations and their policies.

    Args:
        ensembles: All of them, in the order of the notes. Joint policies are left out: others bind their actions, too.
    """
    for ensemble in ensembles:
        key = ("ensembles", ensemble.name)
        for note in ensemble.notes():
            start = f"ensembles.{ensemble.name}."
            inner = note.removeprefix(start).partition(": ")[0].split(".", 1) if note.startswith(start) else ()
            yield (*key, *inner), note
        policy: Any = ensemble.controller.policy
        chosen, names = getattr(policy, "actions", None), ensemble.action.names
        if chosen is None or policy.input == "observation" or len(names) != policy.num_actions or ensemble.shared:
            continue
        for index in {*range(len(names))} - {*map(int, chosen)}:
            told = f"ensemble {ensemble.name!r}: the policy never chooses the action {names[index]!r}"
            yield (*key, "actions", names[index]), told


def of_document(document: dict[str, Any]) -> Iterator[Odd]:
    """Yield oddities of the content of a file.

    Args:
        document: The tables of a file without problems; keys that are absent are not judged.
    """
    ensembles = document["ensembles"]
    definitions: Definitions = {}
    sensors: Sensors = {}
    for kind in ("predicates", "events"):
        for name, given in document.get(kind, {}).items():
            table = {"formula": given} if isinstance(given, str) else given
            definitions[name] = tuple(parse(table[key]) for key in ("formula", "set", "reset") if key in table)
            if "monitor" in table:
                definitions[name] = (Monitor(table["monitor"]).formula,) * 2  # as a latch's: no present value
            if not definitions[name]:
                sensors[kind, name] = table
    yield from _times(document, ())
    yield from _alike(document)
    used = {name for formulas in definitions.values() for formula in formulas for name in formula.names}
    used |= {*texts_in({key: value for key, value in document.items() if key not in {"predicates", "events"}})}
    used |= {name.rpartition("/")[2] for name in used}
    for kind, name in sensors:
        if name not in used:
            yield (kind, name), f"nothing in this file uses {name!r}: what code tells there leads to no decision"
    for name in ensembles:
        yield from _overlaps(name, ensembles, definitions, {each: table for (_, each), table in sensors.items()})
        yield from _bound_twice(name, ensembles)


def _times(table: dict[str, Any], above: tuple[str, ...]) -> Iterator[Odd]:
    """Yield times that look like milliseconds, and rates that look like periods or the other way round."""
    for name, value in table.items():
        keys = (*above, name)
        if isinstance(value, dict):
            yield from _times(value, keys)
            continue
        if not isinstance(value, int | float) or isinstance(value, bool):
            continue
        told = ""
        if name in _LONG and value >= _LONG[name]:
            told = f"are seconds, {value / 60:.3g} min: {value / 1000:g} would be as many milliseconds"
        elif name in _LONG and 0 < value < _BRIEF:
            told = f"are seconds, {1000 * value:g} ms: hardly anything is as fast"
        elif name == "drive" and value > _FAST:
            told = f"are decisions a second, one each {1000 / value:.3g} ms: a drive is a rate"
        elif name == "drive" and value < _SLOW:
            told = f"is a decision each {1 / value:.4g} s: for one each {value:g} s, drive = {1 / value:.4g}"
        if told:
            yield keys, f"{'.'.join(keys)} = {value:g} {told}"


def _alike(document: dict[str, Any]) -> Iterator[Odd]:
    """Yield names that differ by capital letters alone."""
    ensembles = document["ensembles"]
    named: dict[str, list[tuple[str, ...]]] = {"ensembles": [("ensembles", name) for name in ensembles]}
    kinds = ("predicates", "events")
    named["predicates and events"] = [(kind, name) for kind in kinds for name in document.get(kind, ())]
    for name, table in ensembles.items():
        named[f"actions of {name!r}"] = [("ensembles", name, "actions", action) for action in table["actions"]]
    for what, places in named.items():
        spelt: dict[str, str] = {}
        for *above, name in places:
            if (other := spelt.setdefault(name.casefold(), name)) != name:
                yield (*above, name), f"{what}: {other!r} and {name!r} differ by capital letters alone"


def _overlaps(
    name: str, ensembles: dict[str, Any], definitions: Definitions, sensors: dict[str, dict[str, Any]]
) -> Iterator[Odd]:
    """Yield values of a factor that may hold at once, and numbers at which none does."""
    for factor, given in ensembles[name].get("states", {}).items():
        predicates = given.get("predicates", given) if isinstance(given, dict) else given
        sources = [*(predicates.values() if isinstance(predicates, dict) else predicates)]
        key, which = ("ensembles", name, "states", factor), f"of the state factor {factor!r}"
        for one, other in combinations(sources, 2):
            if (definitions.get(one) or definitions.get(other)) and (where := _together(one, other, definitions)):
                yield key, f"ensemble {name!r}: {one!r} and {other!r} {which} are both true where {where}"
        whens = {source: sensors.get(source, {}).get("when") for source in sources}
        told = [{**sensors.get(source, {}), "when": None} for source in sources]  # a topic of ROS, for one
        if len(sources) > 1 and all(whens.values()) and all(each == told[0] for each in told):
            for odd in _thresholds({source: parse_threshold(when) for source, when in whens.items() if when}):
                yield key, f"ensemble {name!r}: {odd} {which}, if all are told the same number"


def _thresholds(thresholds: dict[str, Threshold]) -> Iterator[str]:
    """Yield the first number at which several of the thresholds hold, and the first at which none does.

    The number may come from anywhere: all that follows from each is followed up.
    """
    bounds = sorted({bound for each in thresholds.values() for bound in (each.bound, each.end)})
    between = [(one + other) / 2 for one, other in pairwise(bounds)]
    numbers = sorted({*bounds, *between, bounds[0] - 1, bounds[-1] + 1})
    waiting: list[tuple[bool | None, ...]] = [(None,) * len(thresholds)]
    reached = {*waiting}
    found: dict[bool, str] = {}
    while waiting:
        before = waiting.pop()
        for number in numbers:
            now = tuple(each.of(number, was) for each, was in zip(thresholds.values(), before, strict=True))
            both = [repr(name) for name, holds in zip(thresholds, now, strict=True) if holds]
            if len(both) > 1:
                found.setdefault(True, f"{' and '.join(both)} both hold at {number:g}")
            elif now.count(False) == len(now):
                found.setdefault(False, f"none of {', '.join(map(repr, thresholds))} holds at {number:g}")
            if now not in reached:
                reached.add(now)
                waiting.append(now)
    yield from found.values()


def _together(one: str, other: str, definitions: Definitions) -> str | None:
    """Return where two predicates are both true: one follows from the other, or a common input makes them so."""
    first, second = (_of_inputs(P(name), definitions) for name in (one, other))
    shared, inputs = first.names & second.names, sorted(first.names | second.names)
    if not shared or len(inputs) > _INPUTS:
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
    """Return a formula of inputs and latches alone."""
    if isinstance(formula, P):
        made = definitions.get(formula.name, ())
        return _of_inputs(made[0], definitions) if len(made) == 1 else formula
    return type(formula)(*(_of_inputs(part, definitions) for part in formula.parts)) if formula.parts else formula


def _bound_twice(name: str, ensembles: dict[str, Any]) -> Iterator[Odd]:
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
            told = f"the actions {' and '.join(bound)} start the same ensemble {child!r}{rest}"
            yield ("ensembles", name, "actions", bound[1]), f"ensemble {name!r}: {told}"


def _of_ros(document: dict[str, Any], *, imports: bool) -> Iterator[Odd]:
    if "ros2" not in document:
        return
    from mdm.ros2.tables import notes  # noqa: PLC0415 - other files need nothing of it

    yield from notes(document)
    if importlib.util.find_spec("rclpy") is None:
        yield ("ros2",), "types are unchecked: rclpy cannot be imported here"
    elif not imports:
        yield ("ros2",), "types are unchecked: --import loads them"
