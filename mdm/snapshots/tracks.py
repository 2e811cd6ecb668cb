"""What happened in a record, by subject: entries by their times, for those who ask how it was at one."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from typing import Any

import msgspec

from mdm.messages import ActionLife, Decision, Idle, Mode
from mdm.snapshots.oddities import Ended, likeliest

__all__ = ["EnsembleTracks", "Track"]


class Track:
    """What is known of one subject at each time: entries by their times."""

    def __init__(self) -> None:
        self.times: list[int] = []
        self.entries: list[Any] = []

    def add(self, time: int, entry: Any) -> None:
        """Add an entry that is no earlier than those before."""
        self.times.append(time)
        self.entries.append(entry)

    def last(self, time: int, most: int) -> slice:
        """Return where the last entries by a time are, so many at most."""
        end = self.place(time) + 1
        return slice(max(0, end - most), end)

    def place(self, time: int) -> int:
        """Return the place of the last entry by a time; -1 where there is none."""
        return bisect_right(self.times, time) - 1

    def at(self, time: int) -> Any:
        """Return the last entry by a time; None where there is none."""
        place = self.place(time)
        return None if place < 0 else self.entries[place]


class EnsembleTracks:
    """What happened to an ensemble.

    Args:
        path: Its path.

    Attributes:
        modes: Its modes.
        idles: When it had nothing to do.
        lives: The actions that lived from each change of them on.
        decisions: Its decisions, without their beliefs.
        changes: Those for another action than that of the decision before.
        ends: The ended lives of its actions.
        repeats: Actions that were decided again only because they had ended.
        observations: The times of each observation.
        observed: Its observations.
        seen: The same with the likeliest state of the belief then, where one was searched.
        believes: Whether any decision has a belief.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.modes = Track()
        self.idles = Track()
        self.lives = Track()
        self.decisions = Track()
        self.changes = Track()
        self.ends = Track()
        self.repeats = Track()
        self.observations: defaultdict[Any, list[int]] = defaultdict(list)
        self.observed = Track()
        self.seen = Track()
        self.believes = False
        self._living: dict[int, ActionLife] = {}
        self._lived: list[tuple[str, int, int]] = []

    def add(self, message: Decision | ActionLife | Mode | Idle) -> None:
        """Add what has happened."""
        if isinstance(message, Decision):  # whose belief is read again where one is looked at
            self.believes = self.believes or message.belief is not None
            kept = message if message.belief is None else msgspec.structs.replace(message, belief=None)
            if not self.decisions.entries or self.decisions.entries[-1].action_name != message.action_name:
                self.changes.add(message.time, message.action_name)
            self.decisions.add(message.time, kept)
            if message.cause == "again":
                self.repeats.add(message.time, message.action_name)
            if message.observation is not None:
                self._observe(message)
        elif isinstance(message, Mode):
            self.modes.add(message.time, message)
        elif isinstance(message, Idle):
            self.idles.add(message.time, message)
        else:
            self._live(message)

    def lived(self, end: int) -> list[tuple[str, int, int]]:
        """Return each life of an action, with its beginning and end; that given where it has not ended."""
        return [*self._lived, *[(life.action, life.time, end) for life in self._living.values()]]

    def _observe(self, decision: Decision) -> None:
        symbol = decision.observation
        self.observations[symbol].append(decision.time)
        self.observed.add(decision.time, symbol)
        found = likeliest(decision.belief)
        if found is not None:
            self.seen.add(decision.time, (symbol, *found))

    def _live(self, life: ActionLife) -> None:
        if life.status == "running":
            self._living[life.life] = life
        else:
            begun = self._living.pop(life.life, life)
            self.ends.add(life.time, Ended(life.action, (life.time - begun.time) / 1e9, life.status))
            self._lived.append((life.action, begun.time, life.time))
        self.lives.add(life.time, tuple(self._living.values()))
