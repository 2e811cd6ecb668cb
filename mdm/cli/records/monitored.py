"""``mdm verify FILE.mcap``: whether a recorded run kept to a formula in time, and how a violation came about."""

from __future__ import annotations

import sys
import tempfile
from typing import TYPE_CHECKING, Any

from mdm.actors import PredicateManager
from mdm.cli.report import as_json, printable
from mdm.cli.usage import UsageError
from mdm.config.builder import System
from mdm.config.rebuilt import rebuilt_to_compare
from mdm.config.recorded import as_recorded
from mdm.errors import Error, FormatError
from mdm.logic import Monitor, similar
from mdm.recording import Record
from mdm.replay.replay import replay_predicates

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

_LED = 4
"""Changes of predicates, and decisions, that are told before a violation."""
_OF_MODELS = ("policy", "start", "output", "greatest", "episodes", "seed", "bounds", "false_negative")
_VALUES = {True: "true", False: "false", None: "unknown"}


def run(arguments: argparse.Namespace) -> int:
    """Verify a record; return 1 where the formula is false for ever, else 0."""
    if any(getattr(arguments, name) not in {None, False} for name in _OF_MODELS):
        raise UsageError("a record takes a formula in time, --config and --json; all else is for models")
    try:
        monitor = Monitor(arguments.specification)
    except FormatError as error:
        where = f"the formula does not parse at column {error.column}: {error.message}"
        raise FormatError(f"{where}; a record takes a formula in time, such as 'G(not Stairs)'") from None
    record = Record(arguments.model)
    values: dict[str, bool | None] = {}
    told: list[tuple[int, dict[str, Any]]] = []
    settled = None
    for time, changed in _changes(record, monitor, arguments.config):
        news = [name for name in monitor.names if name in changed and changed[name] is not values.get(name, 0)]
        told += [(time, {"predicate": name, "is": changed[name]}) for name in news]
        values |= changed
        if news and monitor.update(values) is not None:
            settled = time
            break
    led = told[-_LED:] if monitor.verdict is False else []
    if led and record.counts["decisions"]:
        decided = [each.message for each in record.messages(["decisions"], until=settled)][-_LED:]
        led += [(each.time, {"ensemble": each.ensemble, "decides": each.action_name}) for each in decided]
    first = 0 if record.span is None else record.span[0]
    facts = {
        "verdict": monitor.verdict,
        "holds": monitor.holds,
        "seconds": None if settled is None else (settled - first) / 1e9,
        "led": [{"seconds": (time - first) / 1e9, **each} for time, each in sorted(led, key=lambda pair: pair[0])],
    }
    print(as_json(facts) if arguments.json else "\n".join(_lines(facts)))
    for sentence in record.flaws:
        print(f"mdm verify: {sentence}", file=sys.stderr)
    return int(monitor.verdict is False)


def _changes(record: Record, monitor: Monitor, given: str | None) -> list[tuple[int, dict[str, bool | None]]]:
    """Return the values of predicates in a record: see `replay_predicates`."""
    with tempfile.TemporaryDirectory() as folder:
        run = rebuilt_to_compare(record, folder, given)
        manager = run.actors.predicates if isinstance(run.actors, System) else PredicateManager()
        used = [name for name in manager.declared.used if "/" in name and manager.declared.knows(name) == "predicate"]
        known = [*manager.values(), *used]
        for name in monitor.names:
            if name not in known:
                hint = similar(name, known) or f"; {'there are ' + ', '.join(known) if known else 'it has none'}"
                raise Error(f"{record.path}: there is no predicate {name!r} in this record{hint}")
        with as_recorded(record, run.ensembles.values()):
            replayed, found = replay_predicates(record, run.actors, manager, run.transports)
    if not replayed.same:
        print("mdm verify: the replay, which tells predicates, is not as the run: see mdm replay", file=sys.stderr)
    if record.gap is not None:
        print("mdm verify: the verdict is on the run before its first lost message", file=sys.stderr)
    return found


def _lines(facts: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table."""
    verdict, seconds = facts["verdict"], facts["seconds"]
    so_far = {True: "it holds", False: "it does not hold", None: "unknown predicates leave it open"}[facts["holds"]]
    yield f"{'verdict':20}{f'open: {so_far} so far' if verdict is None else f'{_VALUES[verdict]} for ever'}"
    if seconds is not None:
        yield f"{'since' if verdict else 'violated at':20}{seconds:.6g} s"
    for title, each in zip(("led there by", *[""] * 2 * _LED), facts["led"], strict=False):
        (_, time), (_, who), (verb, did) = each.items()
        yield f"{title:20}{f'{time:.6g} s':12}{printable(f'{who} {verb} {_VALUES.get(did, did)}')}"
