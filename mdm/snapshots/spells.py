"""Spells: from when to when something looks odd of an ensemble.

Each rule can change its mind at few times alone: where something happens that it judges by, and where a threshold of
its own is passed. It is asked at these, once all has come that has happened by then, so that nothing is sampled: a
running system and its record have the same spells, and the cost is of the order of what happens.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["Judged", "Spells", "Told"]

Judged = tuple[dict[str, str], float]
"""The texts of a rule by the action that each is of, and when it may change its mind though nothing happens."""


class Told(NamedTuple):
    """That something begins to look odd, or that it is over.

    Attributes:
        time: In nanoseconds.
        status: ``odd`` or ``over``.
        number: The spell's, counted from 1 on by ensemble.
        rule: The rule.
        of: The action that it is of; empty for a belief.
        text: What looked odd when it began, in words.
    """

    time: int
    status: Literal["odd", "over"]
    number: int
    rule: str
    of: str
    text: str


class Spells:
    """Keeps the spells of an ensemble.

    Args:
        rules: Each by its name: judges all that has happened by a time.
        tell: Told of each beginning and end.
        gap: A break of so many nanoseconds at most ends no spell.

    Attributes:
        open: The numbers of the spells over what looks odd now, by rule and action.
    """

    def __init__(self, rules: Mapping[str, Callable[[int], Judged]], tell: Callable[[Told], object], gap: int) -> None:
        self.open: dict[tuple[str, str], int] = {}
        self._rules = rules
        self._tell = tell
        self._gap = gap
        self._due: dict[str, float] = dict.fromkeys(rules, inf)
        self._next = inf
        self._judged = -inf
        self._breaks: dict[tuple[str, str], tuple[int, int]] = {}
        self._number = 0

    def has(self, rule: str) -> bool:
        """Whether something looks odd by a rule."""
        return bool(self.open) and any(key[0] == rule for key in self.open)

    def expect(self, rule: str, time: float) -> None:
        """Have a rule asked at a time, if not before."""
        self._due[rule] = min(self._due[rule], time)
        self._next = min(self._next, time)

    def judge(self, time: int, *rules: str) -> None:
        """Have rules asked once all has come that happened by a time; what comes late is judged with the rest."""
        for rule in rules:
            self.expect(rule, max(time, self._judged))

    def settle(self, until: float) -> None:
        """Judge all times before one."""
        while self._next < until:
            time = self._next
            self._judged = time
            for rule, due in self._due.items():
                if due <= time:
                    self._ask(rule, int(time))
            self._next = min(self._due.values())
        if self._breaks:
            self._end_breaks(until)

    def finish(self, time: int) -> None:
        """End all spells: nothing follows a time."""
        self.settle(time + 1)
        for rule, of in list(self.open):
            self._break(rule, of, time + 1)
        self._end_breaks(inf)

    def _ask(self, rule: str, time: int) -> None:
        found, due = self._rules[rule](time)
        self._due[rule] = due
        for key in [key for key in self.open if key[0] == rule and key[1] not in found]:
            self._break(*key, time)
        for of, text in found.items():
            key = rule, of
            if key in self.open:
                continue
            number, end = self._breaks.pop(key, (0, 0))
            if number and time - end > self._gap:
                self._tell(Told(end, "over", number, rule, of, ""))
                number = 0
            if not number:
                self._number = number = self._number + 1
                self._tell(Told(time, "odd", number, rule, of, text))
            self.open[key] = number

    def _break(self, rule: str, of: str, time: int) -> None:
        self._breaks[rule, of] = self.open.pop((rule, of)), time

    def _end_breaks(self, until: float) -> None:
        for (rule, of), (number, end) in list(self._breaks.items()):
            if until - end > self._gap:
                del self._breaks[rule, of]
                self._tell(Told(end, "over", number, rule, of, ""))
