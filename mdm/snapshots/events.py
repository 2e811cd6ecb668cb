"""The events of a run: actions, decisions, modes, faults, predicates and judgements, as many as there is room for."""

from __future__ import annotations

from collections import deque
from heapq import merge
from itertools import islice
from operator import itemgetter
from typing import TYPE_CHECKING, Literal, get_args

import msgspec

from mdm.faults import KINDS as FAULTS
from mdm.messages import ActionLife, Idle, Mode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mdm.messages import Fault
    from mdm.snapshots.judgement import Told

Kind = Literal["mode", "fault", "idle", "life", "decision", "predicate", "judgement"]

KINDS: tuple[Kind, ...] = get_args(Kind)

ROOM: dict[str, int] = {
    **dict.fromkeys(KINDS, 2_000),
    "mode": 5_000,
    "life": 20_000,
    "decision": 20_000,
    "predicate": 20_000,
}
"""Events of a kind that are kept of a running system."""


class Event(msgspec.Struct, frozen=True, omit_defaults=True, gc=False):
    """An event of a run.

    Attributes:
        number: Counted from 1 on.
        time: In seconds since the run's second 0.
        kind: Its kind.
        source: The ensemble's path; of a fault, the actor's; of a predicate, its manager's.
        name: The mode, the kind of the fault, the action, the predicate as the scene names it, or the rule of a
            judgement.
        detail: In words; of a decision, its cause.
        status: Of an action, ``running`` or how it ended; of an ensemble, ``idle`` or ``busy``; of a predicate,
            ``true``, ``false`` or ``unknown``; of a judgement, ``begins`` or ``over``.
        life: The number of the action's life, of the decision, or of the spell of a judgement.
        remedy: The remedy of a fault.
        count: Of decisions, how many this one stands for.
        at: Of a decision, in which state or on which observation it was made, in words.
    """

    number: int
    time: float
    kind: Kind
    source: str
    name: str
    detail: str = ""
    status: str = ""
    life: int = 0
    remedy: str = ""
    count: int = 1
    at: str = ""


def remedy_of(kind: str) -> str:
    """Return the remedy of a kind of fault; empty where it is none of the library's."""
    return FAULTS[kind].remedy if kind in FAULTS else ""


def event_of(message: ActionLife | Mode | Idle | Fault, seconds: Callable[[int], float]) -> Event:
    """Return a message as an event, which has no number yet."""
    time = seconds(message.time)
    if isinstance(message, ActionLife):
        about = message.detail, message.status, message.life
        return Event(0, time, "life", message.ensemble, message.action, *about)
    if isinstance(message, Mode):
        causes = "; ".join(f"{cause.kind}: {cause.detail}" for cause in message.causes)
        return Event(0, time, "mode", message.ensemble, message.mode, causes)
    if isinstance(message, Idle):
        status = "idle" if message.idle else "busy"
        return Event(0, time, "idle", message.ensemble, message.action, "intended" * message.intended, status)
    return Event(0, time, "fault", message.source, message.kind, message.detail, remedy=remedy_of(message.kind))


def predicate_event(time: float, manager: str, name: str, value: bool | None) -> Event:
    """Return the change of a predicate, of a manager's path, as an event, which has no number yet."""
    status = "unknown" if value is None else "true" if value else "false"
    return Event(0, time, "predicate", manager, name, status=status)


def spell_event(path: str, told: Told, seconds: Callable[[int], float]) -> Event:
    """Return that a judgement begins, or is over, as an event, which has no number yet."""
    return Event(0, seconds(told.time), "judgement", path, told.rule, told.text, told.status, told.number)


class Ring:
    """Keeps the newest events of each kind, so that many decisions leave room for the faults before them.

    A reader holds a cursor: the number of the last event that it has.
    """

    def __init__(self) -> None:
        self.number = 0
        self._kept: dict[Kind, deque[tuple[int, Event, bytes]]] = {kind: deque(maxlen=ROOM[kind]) for kind in KINDS}
        self._encode = msgspec.json.Encoder().encode

    def add(self, time: float, kind: Kind, source: str, name: str, **more: object) -> None:
        """Keep an event; in place of the oldest one of its kind, where there are too many."""
        self.keep(Event(0, time, kind, source, name, **more))  # type: ignore[arg-type]

    def keep(self, event: Event) -> None:
        """Keep an event under the next number."""
        self.number += 1
        event = msgspec.structs.replace(event, number=self.number)
        self._kept[event.kind].append((self.number, event, self._encode(event)))

    @property
    def kept(self) -> dict[Kind, float]:
        """Since when all events of a kind are kept, where earlier ones had to go."""
        return {kind: kept[0][1].time for kind, kept in self._kept.items() if len(kept) == kept.maxlen}

    def __iter__(self) -> Iterator[Event]:
        return (event for _, event, _ in merge(*self._kept.values()))

    def after(self, cursor: int, most: int) -> tuple[list[bytes], int]:
        """Return the first events behind a cursor, encoded, and the cursor behind them.

        Args:
            cursor: The number of the last event that the reader has.
            most: How many at most.
        """
        if cursor >= self.number:
            return [], self.number
        found = []
        for kept in self._kept.values():
            newest = []
            for entry in reversed(kept):
                if entry[0] <= cursor:
                    break
                newest.append(entry)
            found.append(newest[::-1])
        first = islice(merge(*found, key=itemgetter(0)), most)
        merged = [(number, encoded) for number, _, encoded in first]
        if len(merged) < most:
            return [encoded for _, encoded in merged], self.number
        return [encoded for _, encoded in merged], merged[-1][0]
