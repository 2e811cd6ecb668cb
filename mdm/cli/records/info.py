"""``mdm record info``: what is in a record."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.cli.report import as_json, printable
from mdm.recording.reader import Record

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

__all__ = ["run"]

_OWN = {"mdm", "mdm.file", "mdm.end", "mdm.repaired"}
_SHOWN = 4
"""Names of states, observations or actions that are told, of many."""


def run(arguments: argparse.Namespace) -> int:
    """Describe the record; return the exit status."""
    facts = _facts(Record(arguments.file))
    if arguments.json:
        print(as_json(facts))
    else:
        for line in _lines(facts):
            print(line)
    return 0


def _facts(record: Record) -> dict[str, Any]:
    span = record.span
    return {
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
        "head": record.head,
        "metadata": {name: values for name, values in record.metadata.items() if name not in _OWN},
    }


def _lines(facts: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table, without what is not known."""
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
    yield from _table("topic", "messages", [tuple(each.values()) for each in facts["topics"]])
    yield from _table("attached file", "bytes", [tuple(each.values()) for each in facts["attachments"]])


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
