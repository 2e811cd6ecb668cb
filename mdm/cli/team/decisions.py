"""``mdm team decisions``: whether agents have decided the same, and how long they have decided nothing."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import Error
from mdm.team.decisions import Line

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable


class Told(msgspec.Struct, frozen=True):
    """The decisions of an ensemble in the files.

    Attributes:
        agents: The steps in each agent's file.
        caught_up: Those of them that were not carried out there, since others had taken them before.
        pauses: The longest time in seconds from one step that an agent carried out to its next; not after a stop.
        steps: The steps in any file.
        shared: The steps in more than one.
        differing: How many of these are not the same.
        difference: The first of them, in words.
        pause: The longest time in seconds from one step to the next that any agent has told; not after a stop.
        before: The step before that time.
        after: The step after it.
    """

    agents: dict[str, int]
    caught_up: dict[str, int]
    pauses: dict[str, float]
    steps: int
    shared: int
    differing: int
    difference: str | None
    pause: float
    before: str | None
    after: str | None


def run(arguments: argparse.Namespace) -> int:
    """Compare the files; return the exit status."""
    told = tell(read(arguments.paths))
    if arguments.json:
        print(msgspec.json.encode(told).decode())
    else:
        for ensemble, one in told.items():
            print("\n".join(_text(ensemble, one)))
    return int(any(one.differing for one in told.values()))


def read(paths: Iterable[str | Path]) -> list[Line]:
    """Return the steps in files of decisions, or in those of folders.

    Raises:
        Error: If there is no such file, or a line is no step.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        files += sorted(path.glob("*.jsonl")) if path.is_dir() else [path]
    lines = [line for file in files for line in _lines(file)]
    if not lines:
        raise Error(f"there is no decision in {', '.join(map(str, files or paths))}")
    return lines


def _lines(file: Path) -> list[Line]:
    if file.exists() and not file.is_file():
        raise Error(f"{file}: this is a pipe or a device, not a file")
    try:
        *whole, _ = file.read_bytes().split(b"\n")  # the last line is empty, or was broken off by a crash
    except OSError as error:
        raise Error(f"{file}: {error.strerror}") from None
    found = []
    for number, text in enumerate(whole, 1):
        try:
            found.append(msgspec.json.decode(text, type=Line))
        except (msgspec.MsgspecError, ValueError) as error:
            raise Error(f"{file}, line {number}: this is no decision of a team: {error}") from None
    return found


def tell(lines: Iterable[Line]) -> dict[str, Told]:
    """Return the decisions of steps, by ensemble."""
    by_ensemble: dict[str, list[Line]] = {}
    for line in lines:
        by_ensemble.setdefault(line.ensemble, []).append(line)
    return {ensemble: _told(found) for ensemble, found in by_ensemble.items()}


def _told(lines: list[Line]) -> Told:
    agents: dict[str, set[Any]] = {}
    steps: dict[Any, dict[str, Line]] = {}
    for line in sorted(lines, key=lambda line: line.time):
        place = (line.term, line.step)
        agents.setdefault(line.agent, set()).add(place)
        steps.setdefault(place, {}).setdefault(line.agent, line)
    differences = [found for each in steps.values() if (found := _difference(list(each.values()))) is not None]
    firsts = [next(iter(each.values())) for each in steps.values()]
    follows = [(before, after) for before, after in pairwise(firsts) if before.command != "stop"]
    longest = max(follows, key=lambda pair: pair[1].time - pair[0].time, default=None)
    return Told(
        agents={agent: len(places) for agent, places in sorted(agents.items())},
        caught_up={agent: sum(line.caught_up for line in lines if line.agent == agent) for agent in sorted(agents)},
        pauses={agent: _pause([line for line in lines if line.agent == agent]) for agent in sorted(agents)},
        steps=len(steps),
        shared=sum(len(each) > 1 for each in steps.values()),
        differing=len(differences),
        difference=differences[0] if differences else None,
        pause=longest[1].time - longest[0].time if longest else 0.0,
        before=_place(longest[0]) if longest else None,
        after=_place(longest[1]) if longest else None,
    )


def _place(line: Line) -> str:
    """Return which step it is, in words."""
    return f"step {line.step} of term {line.term[0]}, which {line.term[1]!r} leads"


def _pause(lines: list[Line]) -> float:
    """Return the longest time from one step that an agent carried out to its next."""
    done = sorted((line for line in lines if not line.caught_up), key=lambda line: line.time)
    return max((after.time - before.time for before, after in pairwise(done) if before.command != "stop"), default=0.0)


def _difference(lines: list[Line]) -> str | None:
    """Return the first difference between the agents' accounts of one step."""
    one = lines[0]
    for other in lines[1:]:
        for field in ("input", "missing", "command", "action", "digest"):
            mine, its = getattr(one, field), getattr(other, field)
            if mine != its:
                return f"{_place(one)}: {field} is {mine!r} at {one.agent!r} and {its!r} at {other.agent!r}"
    return None


def _text(ensemble: str, told: Told) -> list[str]:
    agents = ", ".join(
        f"{count:,} of {agent}" + (f", {told.caught_up[agent]:,} of them caught up" if told.caught_up[agent] else "")
        for agent, count in told.agents.items()
    )
    same = "the same at all of them" if told.difference is None else f"and {told.differing:,} of these differ"
    text = [
        f"{ensemble}: {told.steps:,} steps ({agents})",
        f"  {told.shared:,} of them told by more than one agent, {same}",
    ]
    if told.difference is not None:
        text.append(f"  first: {told.difference}")
        text.append("  (agents of a communicating team decide each on what it knows, and may differ; others may not)")
    if told.before is not None:
        text.append(f"  longest time without a decision: {told.pause:.3f} s, from {told.before}, to {told.after}")
        longest = max(told.pauses, key=lambda agent: (told.pauses[agent], agent))
        if told.pauses[longest] > told.pause:
            text.append(f"  longest at one agent: {told.pauses[longest]:.3f} s at {longest}")
    return text
