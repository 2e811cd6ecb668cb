"""The stimuli of a record in the words of `mdm trace`, which people type as well: names, no channels or lives.

Both a replay and `mdm trace` give input by `mdm.replay.input`; these words have nothing for poses and ends of calls,
which a replay repeats. Ticks come by themselves, aligned by the clock, whose time at the start is told for them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.errors import Error
from mdm.messages import ActionLife, Belief, Control, Observation, SensorUpdate, State
from mdm.recording.stimuli import Ended, Said, Ticked

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.recording.reader import Record

__all__ = ["traced"]

_COMMANDS = {"start", "stop", "reset", "release"}


def traced(
    record: Record, ensemble: str | None, since: int | None, until: int | None, others: dict[str, int]
) -> Iterator[dict[str, Any]]:
    """Yield the lines that `mdm trace` reads; the last one's time is that of the last decision, or later.

    Args:
        record: The record.
        ensemble: What is said to this ensemble alone, beside what sensors say; by default to all.
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
    if start and _ticks(record):
        yield {"time": 0.0, "epoch": start}
    latest = start
    for latest, line in _said(record, ensemble, since, until, others):
        yield {"time": (latest - start) / 1e9, **line}
    decided = record.raw(["decisions"], since, until) if "decisions" in record.topics else ()
    last = max((time for _, time, _, _ in decided), default=latest)
    if last > latest:  # ticks and timers decide until then
        yield {"time": (last - start) / 1e9}


def _ticks(record: Record) -> bool:
    """Whether anything ticks at a fixed rate."""
    return any(isinstance(each.message, Ticked) for each in record.messages(["stimuli"]))


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
    """Yield what each stimulus says, and its time."""
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
    """Return what a message on a channel is for `mdm trace`, None where it has no words for it."""
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


def _decisions(record: Record, since: int | None, until: int | None) -> Iterator[tuple[str, int, int, bytes]]:
    """Return the decisions, as they are in the file."""
    return record.raw(["decisions"], since, until) if "decisions" in record.topics else iter(())


def _actions(record: Record) -> dict[tuple[str, int], str]:
    """Return the actions of lives."""
    if "lives" not in record.topics:
        return {}
    lives = (each.message for each in record.messages(["lives"]))
    return {(life.ensemble, life.life): life.action for life in lives if isinstance(life, ActionLife)}
