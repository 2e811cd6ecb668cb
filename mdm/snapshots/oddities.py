"""Oddities of a run in words, and from when to when each lasts: nothing has failed, and yet somebody should look.

Each function judges the last events, at a cost of the order of their number. They are heuristics: their limits lie
where robots that do well do not come.

Each rule can change its mind at few times alone: where something happens that it judges by, and where a threshold of
its own is passed. It is asked at these, once all messages until then have come, so that nothing is sampled: a running
system and its record have the same spells, and the cost is of the order of the messages.
"""

from __future__ import annotations

from collections import Counter
from math import ceil, inf
from statistics import median
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

WINDOW = 5.0
"""Seconds in which decisions that repeat are counted."""
KEPT = 200
"""Ended lives of an ensemble's actions by which it is judged how long one usually takes."""
SEEN = 40
"""Observations by which it is judged whether a belief moves."""

OFTEN = 10
"""Decisions in the window, each made only because the action of the one before had ended."""
_FACTOR = 5.0
"""Times the usual duration of an action from which on it lasts long."""
SHORT, _LONG = 10.0, 30.0
"""Seconds below which no action lasts long: one whose usual duration is known, and one that has hardly ever ended."""
_OWN, _OTHERS = 3, 2
"""Ended lives that it takes to know how long an action usually takes: its own, or those of the others."""
FEW, _RARE, _STILL = 20, 3, 10.0
"""Observations, those of a second kind among them, and the seconds over which a belief should have moved."""
_SURE = 0.9
"""The probability of the likeliest state from which on a belief may well stand still under noise."""
MOVED = 1e-3
"""By how much the probability of the likeliest state changes at least where a belief moves."""


class Ended(NamedTuple):
    """An ended life of an action: its name, seconds, and how it has ended."""

    action: str
    seconds: float
    status: str


class Seen(NamedTuple):
    """An observation: seconds, its symbol, and the likeliest state of the belief then with its probability."""

    time: float
    observation: object
    state: int
    chance: float


def repeated(action: str, times: int) -> str:
    """Return that an action was decided over and over, on nothing new; empty where that is not odd.

    A decision that keeps a running action, and one at a tick or on an input, is none of these.

    Args:
        action: The action.
        times: How often it was decided in the last `WINDOW` seconds only because it had ended.
    """
    if times < OFTEN:
        return ""
    return f"decided {action} {times} times in the last {WINDOW:g} s, each time because it had just ended"


def lasting(action: str, seconds: float, ended: Sequence[Ended]) -> str:
    """Return that an action lasts long beyond its time; empty where it does not.

    Its time is the median of its own lives that came to an end by themselves; where there are too few to know, the
    longest of these and of the other actions'. An action that others usually end has no time of
    its own.

    Args:
        action: The live action.
        seconds: How long it has been live.
        ended: The ended lives of its ensemble, `KEPT` at most.
    """
    if seconds < SHORT:
        return ""
    limit, usual = _usual(action, ended)
    return "" if seconds < limit else f"{action} has lasted for {_words(seconds)}{usual}"


def lasts_long(action: str, ended: Sequence[Ended]) -> float:
    """Return from how many nanoseconds on an action lasts long; infinity where nothing tells it."""
    limit, _ = _usual(action, ended)
    return limit if limit == inf else ceil(limit * 1e9)


def _usual(action: str, ended: Sequence[Ended]) -> tuple[float, str]:
    """Return from how many seconds on an action lasts long, and in words how long it, or others, took."""
    own = [each for each in ended if each.action == action]
    done = [each.seconds for each in own if each.status == "succeeded"]
    if own and 2 * len(done) <= len(own):
        return inf, ""
    if len(done) >= _OWN:
        usual = median(done)
        return max(SHORT, _FACTOR * usual), f"; it usually takes {_words(usual)}"
    others = [each.seconds for each in ended if each.status == "succeeded" and each.action != action]
    if done:
        return max(_LONG, _FACTOR * max(done + others)), f"; it took {_words(max(done))} at most before"
    if len(others) < _OTHERS:
        return inf, ""
    return max(_LONG, _FACTOR * max(others)), f" and has never ended; other actions took {_words(max(others))} at most"


def unmoved(seen: Sequence[Seen], observation: Callable[[object], str], state: Callable[[int], str]) -> str:
    """Return that a belief stands still though observations that differ come; empty where it moves.

    Where all observations are the same, a belief that stands still may well be right; so may one that is all but sure.

    Args:
        seen: The last observations, `SEEN` at most.
        observation: Names an observation.
        state: Names a state.
    """
    if len(seen) < FEW or seen[-1].time - seen[0].time < _STILL or len({each.state for each in seen}) > 1:
        return ""
    chances = [each.chance for each in seen]
    tally = Counter(each.observation for each in seen).most_common(3)
    if max(chances) >= _SURE or max(chances) - min(chances) >= MOVED or len(tally) < 2 or tally[1][1] < _RARE:
        return ""
    came = ", ".join(f"{observation(symbol)} {count} times" for symbol, count in tally)
    last = seen[-1]
    return (
        f"the belief has not moved for {_words(last.time - seen[0].time)} though observations differ ({came}): "
        f"{state(last.state)} at {100 * last.chance:.4g} %"
    )


def _words(seconds: float) -> str:
    if seconds < 10:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds // 60:.0f} min {seconds % 60:.0f} s"


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
        text: The oddity as it began, in words.
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
        open: The numbers of the spells that go on, by rule and action.
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
        """Ask a rule at a time, if not before."""
        self._due[rule] = min(self._due[rule], time)
        self._next = min(self._next, time)

    def judge(self, time: int, *rules: str) -> None:
        """Ask rules about a time once all messages until then have come; late ones are judged with the rest."""
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
