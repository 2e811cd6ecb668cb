"""``mdm record info`` and ``cat``: a record described, and its messages, or stimuli in the words of `mdm trace`.

These words are names, no channels or lives. Both a replay and `mdm trace` give input by `mdm.replay.input`; the words
have nothing for poses and ends of calls, which a replay repeats. Ticks come by themselves, aligned by the clock, whose
time at the start is told for them.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.cli.records.page import recorded_run
from mdm.cli.report import as_json, printable
from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.messages import ActionLife, Belief, Control, Observation, SensorUpdate, State
from mdm.recording.part import SYSTEM
from mdm.recording.reader import Record
from mdm.recording.table import Names, names_of
from mdm.snapshots.frame import Judgement
from mdm.stimuli import Ended, Said, Ticked

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

_FIELDS = ("ensemble", "source", "actor", "channel")
"""The fields of messages that name an ensemble, or something of it, by a path."""

_NAMED = {"mdm.Decision", "mdm.State", "mdm.Observation"}
"""The types of messages with states or observations, whose names are printed beside their numbers."""
_COMMANDS = {"start", "stop", "reset", "release", "decide_again"}
_OWN = {"mdm", "mdm.file", "mdm.end", "mdm.repaired", SYSTEM}
_SHOWN = 4
"""Names of states, observations or actions that are told, of many."""


def info(arguments: argparse.Namespace) -> int:
    """Describe the record; return the exit status."""
    record = Record(arguments.file)
    span = record.span
    facts = {
        "files": [str(path) for path in record.paths],
        "bytes": record.size,
        "complete": record.torn is None and not record.damage and not record.damaged_files,
        "torn": record.torn,
        "damage": list(record.damage),
        "damaged_files": record.damaged_files,
        "unread": record.unread,
        "ended_in_order": record.closed,
        "lost": record.lost,
        "first": None if span is None else span[0],
        "last": None if span is None else span[1],
        "seconds": None if span is None else (span[1] - span[0]) / 1e9,
        "messages": record.counts.total(),
        "topics": [
            {"name": topic.name, "type": topic.schema_name, "messages": record.counts[topic.name]}
            for topic in record.topics.values()
        ],
        "attachments": [
            {"name": each.name, "media_type": each.media_type, "bytes": len(each.data)} for each in record.attachments
        ],
        "cannot": list(record.cannot),
        "head": {name: value for name, value in record.head.items() if name != "cannot"},
        "metadata": {name: values for name, values in record.metadata.items() if name not in _OWN},
        "judgements": _judgements(record),
    }
    print(as_json(facts) if arguments.json else "\n".join(_lines(facts)))
    return 0


def _lines(facts: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table, without unknown values."""
    ends = {True: "in order", False: "its process ended before it closed the record", None: None}
    told = {
        "bytes": f"{facts['bytes']:,}",
        "complete": "yes" if facts["complete"] else "no",
        "torn": facts["torn"],
        "unread bytes": f"{facts['unread']:,}" if facts["unread"] else None,
        "end of the run": ends[facts["ended_in_order"]],
        "seconds": None if facts["seconds"] is None else f"{facts['seconds']:g}",
        "messages": f"{facts['messages']:,}",
        "lost messages": f"{facts['lost']:,}" if facts["lost"] else None,
        **facts["head"],
    }
    for name, values in facts["metadata"].items():
        told |= {f"{name.removeprefix('ensemble ')}: {key}": _told(value) for key, value in values.items()}
    width = max(22, min(38, max(map(len, told)))) + 2
    yield from (f"{'file':{width}}{path}" for path in facts["files"])
    for key, value in told.items():
        if key == "lost messages":
            yield from (f"{'damaged':{width}}{sentence}" for sentence in facts["damage"])
            yield from (f"{'damaged file':{width}}{printable(name)}" for name in facts["damaged_files"])
        if value is not None:
            yield f"{printable(key, width - 2):{width}}{value if key == 'torn' else printable(value)}"
    yield from (f"{'not in the record':{width}}{printable(sentence)}" for sentence in facts["cannot"])
    for each in facts["judgements"]:
        yield f"{each['severity']:{width}}{printable(str(msgspec.convert(each, Judgement)))} → {each['remedy']}"
    yield from _table("topic", "messages", [tuple(each.values()) for each in facts["topics"]])
    yield from _table("attached file", "bytes", [tuple(each.values()) for each in facts["attachments"]])


def _judgements(record: Record) -> list[dict[str, Any]]:
    """Return the judgements of the run, the worst first; none where its messages cannot be read."""
    try:
        return [] if record.span is None else msgspec.to_builtins(recorded_run(record, replay=False).judgements)
    except Error:
        return []


def _told(value: str) -> str:
    """Return a list of names as their number and the first of them, factors with their values; others as they are."""
    with suppress(msgspec.MsgspecError):
        return (
            f"{len(msgspec.json.decode(value, type=dict[str, str])):,}, of which a replay names the first that differs"
        )
    try:
        names: list[str] | dict[str, list[str]] = msgspec.json.decode(value, type=list[str] | dict[str, list[str]])
    except msgspec.MsgspecError:
        return value
    if isinstance(names, dict):
        return "; ".join(f"{factor}: {', '.join(symbols)}" for factor, symbols in names.items())
    return f"{len(names):,}: {', '.join(names[:_SHOWN])}{', …' if len(names) > _SHOWN else ''}"


def _table(name: str, number: str, lines: list[tuple[str, str, int]]) -> Iterator[str]:
    if lines:
        yield ""
        yield f"{name:40}{'type':24}{number:>12}"
    for first, second, count in lines:
        yield f"{printable(first, 38):40}{printable(second, 22):24}{count:>12,}"


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
            message = msgspec.json.decode(data)
            fields = [message.get(field) for field in _FIELDS] if isinstance(message, dict) else []
            paths = {path for path in (topic if "/" in topic else None, *fields) if isinstance(path, str) and path}
            if not any(path == arguments.ensemble or path.startswith(f"{arguments.ensemble}/") for path in paths):
                known |= paths
                continue
        printed += 1
        line: dict[str, Any] = {"topic": topic, "seconds": (time - start) / 1e9, "sequence": sequence}
        if topic in named:
            kind, message = record.topics[topic].schema_name, msgspec.json.decode(data)
            decision = kind == "mdm.Decision"
            own = names.get(message["ensemble"] if decision else topic.rpartition("/")[0], Names())
            state = message["state"] if decision else message["index"] if kind == "mdm.State" else None
            seen = message["observation"] if decision else message["index"] if kind == "mdm.Observation" else None
            found = {"state_name": own.state(state), "observation_name": own.observation(seen)}
            line |= {key: name for key, name in found.items() if name is not None}
        head = as_json(line)
        print(f'{head[:-1]},"message":{data.decode()}}}')
    if arguments.ensemble is not None and not printed:
        there = f"; there are messages of {', '.join(sorted(known)[:12])}" if known else ""
        raise Error(f"{record.path}: there are no messages of {arguments.ensemble!r}{there}")


def _print_stimuli(record: Record, ensemble: str | None, since: int | None, until: int | None) -> None:
    others: dict[str, int] = {}
    for line in traced(record, ensemble, since, until, others):
        print(as_json(line))
    if others:
        sys.stdout.flush()
        told = ", ".join(f"{count:,} on {channel}" for channel, count in others.items())
        print(f"mdm record cat: left out, since mdm trace has no words for them: {told}", file=sys.stderr)


def traced(
    record: Record, ensemble: str | None, since: int | None, until: int | None, others: dict[str, int]
) -> Iterator[dict[str, Any]]:
    """Yield the lines that `mdm trace` reads; the last one's time is that of the last decision, or later.

    Args:
        record: The record.
        ensemble: Take the stimuli of this ensemble alone, beside those of sensors; by default of all.
        since: From this time on.
        until: Before this time.
        others: Where the numbers of stimuli are put that it has no words for, by their channels.

    Raises:
        Error: If the record has no stimuli, or no such ensemble.
    """
    if not record.counts["stimuli"]:
        raise Error(f"{record.path}: there are no stimuli in this record")
    if ensemble is not None and ensemble not in (known := _ensembles(record)):
        there = f"; there are messages of {', '.join(sorted(known)[:12])}" if known else ""
        raise Error(f"{record.path}: there are no messages of {ensemble!r}{there}")
    start = 0 if record.span is None else record.span[0]
    if start and any(isinstance(each.message, Ticked) for each in record.messages(["stimuli"])):
        yield {"time": 0.0, "epoch": start}
    latest = start
    for latest, line in _said(record, ensemble, since, until, others):
        yield {"time": (latest - start) / 1e9, **line}
    decided = record.raw(["decisions"], since, until) if "decisions" in record.topics else ()
    last = max((time for _, time, _, _ in decided), default=latest)
    if last > latest:  # ticks and timers decide until then
        yield {"time": (last - start) / 1e9}


def _ensembles(record: Record) -> set[str]:
    """Return the paths of all ensembles that decide, or to which something is said."""
    known = {name.removeprefix("ensemble ") for name in record.metadata if name.startswith("ensemble ")}
    for _, _, _, stimulus in record.messages(["stimuli"]):
        if isinstance(stimulus, Ended):
            known.add(stimulus.ensemble)
        elif isinstance(stimulus, Said):
            path, _, name = stimulus.channel.rpartition("/")
            if _line(name, stimulus.message) is not None and name != "sensed":
                known.add(path)
    return known


def _said(
    record: Record, ensemble: str | None, since: int | None, until: int | None, others: dict[str, int]
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the words of each stimulus, and its time."""
    actions = _actions(record)
    for _, time, _, stimulus in record.messages(["stimuli"], since, until):
        if isinstance(stimulus, Said):
            path, _, name = stimulus.channel.rpartition("/")
            if ensemble is not None and name != "sensed" and path != ensemble:
                continue
            line = _line(name, stimulus.message)
            if line is None:
                others[stimulus.channel] = others.get(stimulus.channel, 0) + 1
            else:
                yield time, line if name == "sensed" else line | {"ensemble": path.rpartition("/")[2]}
        elif isinstance(stimulus, Ended) and not (stimulus.cancelled or stimulus.abandoned):
            action = actions.get((stimulus.ensemble, stimulus.life))
            if action is not None and ensemble in {None, stimulus.ensemble}:
                yield time, {"events": [f"{action}.{'succeeded' if stimulus.error is None else 'failed'}"]}


def _line(channel: str, message: Any) -> dict[str, Any] | None:
    """Return a message on a channel in the words of `mdm trace`, None where it has none."""
    if channel == "sensed" and isinstance(message, SensorUpdate):
        line: dict[str, Any] = {"predicates": dict(message.predicates)} if message.predicates else {}
        return line | ({"events": list(message.events)} if message.events else {})
    if channel == "state" and isinstance(message, State) and message.index is not None:
        return {"state": message.index}
    if channel == "observation" and isinstance(message, Observation):
        return {"observation": list(message.values) if message.index is None else message.index}
    if channel == "external_belief" and isinstance(message, Belief):
        return {"belief": message.probabilities}
    if channel == "control" and isinstance(message, Control) and message.command in _COMMANDS:
        return {"control": message.command}
    return None


def _actions(record: Record) -> dict[tuple[str, int], str]:
    """Return the actions of lives."""
    if "lives" not in record.topics:
        return {}
    lives = (each.message for each in record.messages(["lives"]))
    return {(life.ensemble, life.life): life.action for life in lives if isinstance(life, ActionLife)}
