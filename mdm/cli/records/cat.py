"""``mdm record cat``: the messages of a record, or the stimuli that `mdm trace` reads."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.cli.records.traced import traced
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.recording.names import Names, names_of
from mdm.recording.reader import Record

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]

_FIELDS = ("ensemble", "source", "actor", "channel")
"""The fields of messages that name an ensemble, or something of it, by a path."""

_NAMED = {"mdm.Decision", "mdm.State", "mdm.Observation"}
"""The types of messages with states or observations, whose names are printed beside their numbers."""


def run(arguments: argparse.Namespace) -> int:
    """Print the messages; return the exit status."""
    if arguments.stimuli and arguments.topic:
        raise UsageError("--topic is for messages, and --stimuli prints what mdm trace reads")
    record = Record(arguments.file)
    _check_part(record, arguments.since, arguments.until)
    start = 0 if record.span is None else record.span[0]
    since = None if arguments.since is None else start + round(arguments.since * 1e9)
    until = None if arguments.until is None else start + round(arguments.until * 1e9)
    if arguments.stimuli:
        _print_stimuli(record, arguments.ensemble, since, until)
    else:
        _print_messages(record, arguments, since, until)
    sys.stdout.flush()
    for sentence in record.flaws:
        print(f"mdm record cat: {sentence}", file=sys.stderr)
    return 0


def _check_part(record: Record, since: float | None, until: float | None) -> None:
    """Refuse a part of the record's time in which nothing can be."""
    if record.span is None or (since is None and until is None):
        return
    start, last = record.span
    whole, begin = (last - start) / 1e9, since or 0.0
    if begin > whole or (until is not None and until <= max(begin, 0.0)):
        part = f"from second {begin:g} on" if until is None else f"between the seconds {begin:g} and {until:g}"
        raise Error(f"{record.path}: there is nothing to print {part}: the record lasts {whole:g} s")


def _print_messages(record: Record, arguments: argparse.Namespace, since: int | None, until: int | None) -> None:
    start = 0 if record.span is None else record.span[0]
    named = {name for name, topic in record.topics.items() if topic.schema_name in _NAMED}
    names = names_of(record)
    known: set[str] = set()
    printed = 0
    for topic, time, sequence, data in record.raw(arguments.topic, since, until):
        if arguments.ensemble is not None:
            paths = _paths(topic, msgspec.json.decode(data))
            if not any(_is_of(path, arguments.ensemble) for path in paths):
                known |= paths
                continue
        printed += 1
        line: dict[str, Any] = {"topic": topic, "seconds": (time - start) / 1e9, "sequence": sequence}
        if topic in named:
            line |= _names(names, topic, record.topics[topic].schema_name, msgspec.json.decode(data))
        head = as_json(line)
        print(f'{head[:-1]},"message":{data.decode()}}}')
    if arguments.ensemble is not None and not printed:
        there = f"; there are messages of {', '.join(sorted(known)[:12])}" if known else ""
        raise Error(f"{record.path}: there are no messages of {arguments.ensemble!r}{there}")


def _names(names: dict[str, Names], topic: str, kind: str, message: dict[str, Any]) -> dict[str, str]:
    """Return the names of a message's state and observation, as far as they have any."""
    decision = kind == "mdm.Decision"
    own = names.get(message["ensemble"] if decision else topic.rpartition("/")[0], Names())
    state = message["state"] if decision else message["index"] if kind == "mdm.State" else None
    observation = message["observation"] if decision else message["index"] if kind == "mdm.Observation" else None
    found = {"state_name": own.state(state), "observation_name": own.observation(observation)}
    return {key: name for key, name in found.items() if name is not None}


def _print_stimuli(record: Record, ensemble: str | None, since: int | None, until: int | None) -> None:
    others: dict[str, int] = {}
    for line in traced(record, ensemble, since, until, others):
        print(as_json(line))
    if others:
        sys.stdout.flush()
        told = ", ".join(f"{count:,} on {channel}" for channel, count in others.items())
        print(f"mdm record cat: left out, since mdm trace has no words for them: {told}", file=sys.stderr)


def _paths(topic: str, message: Any) -> set[str]:
    """Return the paths of all that a message names."""
    fields = [message.get(field) for field in _FIELDS] if isinstance(message, dict) else []
    return {path for path in (topic if "/" in topic else None, *fields) if isinstance(path, str) and path}


def _is_of(path: str, ensemble: str) -> bool:
    return path == ensemble or path.startswith(f"{ensemble}/")
