"""Judgements of a run: a fault of the robot, its model or its team, since when, by which evidence, with a remedy.

A rule changes its mind where something happens that it judges by, and where a threshold of its own is passed. It is
asked at these times alone, once all messages until then have come, so that nothing is sampled: a running system and its
record have the same judgements, and the cost is of the order of the messages. Thresholds lie where robots that do well
do not come; each stands here once, with its reason.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import Counter, defaultdict, deque
from contextlib import suppress
from functools import partial
from heapq import nsmallest
from math import ceil, exp, inf, log, sqrt
from operator import itemgetter
from statistics import median
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, NamedTuple

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.faults import KINDS
from mdm.snapshots.beliefs import likeliest
from mdm.snapshots.frame import Judgement
from mdm.snapshots.words import at_state

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from mdm.messages import ActionLife, Decision, Fault, Idle, Mode
    from mdm.snapshots.reducer import Known


class Rule(NamedTuple):
    """A rule.

    Attributes:
        severity: ``wrong``, or ``look`` where it is worth a look.
        when: When it names something.
        remedy: Where to look then.
    """

    severity: str
    when: str
    remedy: str


_TABLE = """\
safe | wrong | the ensemble is safe | Do what the remedy of the cause says; then release the ensemble.
fails | wrong | an action failed three times and never succeeded, eight times in a row, or 15 of its last 20 times; a \
plain function failed five times within a minute | Check the callback, and what it talks to: the detail of its last \
failure stands beside it.
hangs | wrong | an action lasts five times as long as it usually takes, four times as long as all its lives but one, \
and ten seconds at least; one that has ended less than three times, five times as long as it or any other has taken, \
and half a minute at least | Check what the action waits for; a `timeout` ends one that hangs.
apart | wrong | an agent of the team was never met, or is lost | See to its process and the network; `mdm team \
status` asks all agents.
disagrees | wrong | an agent was refused, is there twice, or has another copy of the team's state than the others; \
until a minute after the last such fault | Give all agents the same file, model, policy and version; look for two \
processes of one name.
pre-empted | look | an action was pre-empted six times in a row, within a minute, each time within five seconds, in \
an ensemble in which actions do succeed | Check whether the action hangs, and what makes the ensemble decide again so \
soon: a predicate that flickers?
repeats | look | an action was decided ten times within five seconds, each time only because it had ended | Check \
that the action changes what it is decided on, or give it a `pause`.
waits | look | an ensemble that should decide cannot, for ten seconds or more | Check who tells what it waits for; \
the evidence names that.
impossible | look | five or more of the last 50 changes of the state are impossible by the model, and a fifth of them \
or more; states that last less than half a second do not count, for factors may change one after another | Check how \
predicates and events are wired, and whether the model allows what happens.
contradicts | look | observations are less likely under the belief than the model itself expects: over up to 200 of \
them, by .15 nats each, and by 12 nats and four standard deviations in all | Check the wiring of sensors and actions; \
then estimate the model from the record: `mdm statistics`.
stuck | look | a factor of the state, or the observation, stays the same for ten seconds or more, over actions that \
came to their end, although the model gives that a chance below one in ten million | Check the sensor that tells it, \
and whether the actions reach what they should.
unmoved | look | over twenty observations or more that differ, and ten seconds, the belief does not move, though it \
is not all but sure (90 %) | Check the observation probabilities of the model: these do not tell its states apart.
flickers | look | a predicate changes ten times within ten times its `held_for`, or within five seconds where that is \
longer | Let its number change by two thresholds (`until`), or let it hold before it counts (`held_for`).
same | look | without a model, the same action is decided 50 times in a row in the same state, for a minute or more, \
each time because it had ended | Check that the action reaches what it should, and that a sensor tells so.
idle | look | an ensemble has had nothing to do for half a minute, and its action does not say that it waits then | \
Say `then = "decide"` or `"wait"` at the action, or see why no input changes.
shielded | look | the shield replaced ten or more of the last 50 decisions | Check why the policy wants what is \
dangerous: solve it with the shield's bound, or allow more.
late | look | five ticks were missed within ten seconds; or three faults of lateness within a minute, or one of \
clocks | See what holds the event loop, the processor or the network; decide less often.
faults | look | the same kind of fault came from the same actor five times within a minute | Do what the remedy of \
the fault says.
"""
RULES: Final = {name: Rule(*row) for name, *row in (line.split(" | ") for line in _TABLE.splitlines())}
"""The rules by name, the worst first."""

_WINDOW = 5 * 10**9
"""Nanoseconds in which decisions that repeat are counted."""
KEPT = 200
"""Ended lives of an ensemble's actions by which it is judged how long one usually takes."""
_SEEN = 40
"""Observations by which it is judged whether a belief moves."""
_OFTEN = 10
"""Decisions in the window, each made only because the action of the one before had ended."""
_FACTOR, _LATE = 5.0, 4.0
"""Times the usual duration of an action from which on it lasts long, and times that of all its lives but one: ways of a
robot are short and long."""
SHORT, _LONG = 10.0, 30.0
"""Seconds below which no action lasts long: one whose usual duration is known, and one that has hardly ever ended."""
_OWN, _OTHERS = 3, 2
"""Ended lives that it takes to know how long an action usually takes: its own, or those of the others."""
_FEW, _RARE, _STILL = 20, 3, 10.0
"""Observations, those of a second kind among them, and the seconds over which a belief should have moved."""
_SURE = 0.9
"""The probability of the likeliest state from which on a belief may well stand still under noise."""
_MOVED = 1e-3
"""By how much the probability of the likeliest state changes at least where a belief moves."""
_NEVER, _ROW, _MANY, _LAST = 3, 8, 15, 20
"""Failures of an action that never succeeded; in a row; and of so many last ends.

An action that fails one time in three by itself, as its model may say, comes to eight in a row, or 15 of 20, once in
ten thousand times.
"""
_PLAIN = 5
"""Failures within a minute of a plain function, of whose successes nobody hears."""
_CUT = 6
"""Times in a row that an action is pre-empted."""
_SETTLES = 500_000_000
"""Nanoseconds from which on a state counts: factors that change one after another pass through others."""
_STEPS, _IMPOSSIBLE, _FIFTH = 50, 5, 0.2
"""Changes of the state, and how many of them, and which part, are impossible: factors one after another make a few."""
_SERIES = 200
"""Steps over which outcomes are held against the model: some minutes of most robots, and memory of a few kilobytes."""
_NATS, _DEVIATIONS, _EXCESS = 12.0, 4.0, 0.15
"""Under a model that is right the excess has mean 0: it passes four standard deviations and 12 nats, which also hold
for rare events, in one of 10^6 series; the share a step lets a model be a little wrong."""
_CHANCE = 16.0
"""Nats: a chance of one in ten million comes true once in a thousand hours of a step a second."""
_FLOOR = log(1e-3)
"""The least logarithm of a probability that counts: one observation alone never contradicts a model."""
_SMALL, _LARGE = 100_000, 1_000
"""Entries up to which a model that is not flat is made flat, on the robot's machine, and states up to which a belief is
predicted, and rows are looked at: to do so costs their number, or its square."""
_CHANGES, _PERIOD = 10, 500_000_000
"""Changes of a predicate that are too many, and the nanoseconds a change: what a robot decides on lasts for longer."""
_ALIKE = 50
"""Equal decisions in a row, where no model says how long one waits."""
_IDLE = 30 * 10**9
"""Nanoseconds of idleness: a robot between two orders is idle for seconds."""
_MISSED, _TICKS = 5, 10 * 10**9
"""Ticks that are missed, and in how many nanoseconds: one long pause of the collector misses a few."""
_MINUTE = 60 * 10**9
"""Nanoseconds within which faults, failures and pre-emptions count together."""
_MOST = 100
"""Judgements that are told."""
_SHORT = round(SHORT * 1e9)
SAFE_ACTION = "safe action"

_FAULTS = {
    **dict.fromkeys(("refused", "digest", "history", "duplicate", "stranger", "snapshot"), ("disagrees", 1)),
    **dict.fromkeys(("deadline", "stall", "late", "untimely", "missing"), ("late", 3)),
    "clock": ("late", 1),
}
"""The rule of a kind of fault, and how many within a minute it takes; that of all others is ``faults``, and five."""
_ELSEWHERE = frozenset({"action", "idle", "waiting", "livelock", "missing_teammate", "lost_teammate", "safe_action"})
"""Kinds of faults that other rules judge."""


def judged(
    ensembles: Mapping[str, Spells],
    run: Iterable[Spells],
    time: int,
    seconds: Callable[[int], float],
    *,
    stopped: bool,
) -> tuple[tuple[Judgement, ...], str]:
    """Return the judgements of a run by a time, and the worst in words, as `worst_first` does.

    Args:
        ensembles: The judge of each ensemble, by its path.
        run: The judges of faults, predicates and agents.
        time: In nanoseconds.
        seconds: Of a time, since the run's second 0.
        stopped: Whether all ensembles are stopped, so that the worst may be over.
    """
    found = []
    for path, spells in (*ensembles.items(), *(("", judge) for judge in run)):
        for rule, of, each, end in spells.at(time) if spells.named else ():
            severity, _, remedy = RULES[rule]
            since, until = seconds(each.since), None if end is None else seconds(end)
            told = each.times, since, each.text, each.evidence, each.remedy or remedy, until
            found.append(Judgement(rule, path or of, of if path else "", severity, *told))
    return worst_first(found, stopped=stopped)


def worst_first(found: Iterable[Judgement], *, stopped: bool) -> tuple[tuple[Judgement, ...], str]:
    """Return the worst judgements, 100 at most, and the first in words, which is empty where nothing is named.

    First come those that last, then those that are wrong, by the order of `RULES`, then by count.

    Args:
        found: The judgements, of all agents.
        stopped: Whether all ensembles are stopped, so that the worst may be over.
    """
    ranks = {rule: place for place, rule in enumerate(RULES)}
    worst = nsmallest(
        _MOST,
        found,
        key=lambda each: (
            *(each.until is not None, each.severity != "wrong", ranks[each.rule]),
            *(-each.count, each.since, each.of, each.subject),
        ),
    )
    is_named = bool(worst) and (worst[0].until is None or stopped)
    return tuple(worst), str(worst[0]) if is_named else ""


class Found(NamedTuple):
    """A finding of a rule.

    Attributes:
        times: How often.
        since: Since which time, in nanoseconds.
        text: In words.
        evidence: The evidence, in words.
        remedy: In place of that of the rule, where there is a better one.
    """

    times: int
    since: int
    text: str
    evidence: str = ""
    remedy: str = ""


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


def lasts_long(action: str, ended: Iterable[Ended]) -> tuple[float, str]:
    """Return from how many seconds on an action lasts long, infinity where nothing tells it, and why in words.

    Its time is the median of its own lives that came to an end by themselves; where there are too few to know, the
    longest of these and of the other actions'. An action that others usually end has no time of its own.

    Args:
        action: The live action.
        ended: The ended lives of its ensemble, `KEPT` at most.
    """
    ended = [*ended]
    own = [each for each in ended if each.action == action]
    done = [each.seconds for each in own if each.status == "succeeded"]
    if own and 2 * len(done) <= len(own):
        return inf, ""
    if len(done) >= _OWN:
        usual = median(done)
        return max(SHORT, _FACTOR * usual, _LATE * sorted(done)[-2]), f"it usually takes {_words(usual)}"
    others = [each.seconds for each in ended if each.status == "succeeded" and each.action != action]
    if done:
        return max(_LONG, _FACTOR * max(done + others)), f"it took {_words(max(done))} at most before"
    if len(others) < _OTHERS:
        return inf, ""
    return max(_LONG, _FACTOR * max(others)), f"it has never ended, and others took {_words(max(others))} at most"


def unmoved(seen: Sequence[Seen], observation: Callable[[object], str], state: Callable[[int], str]) -> str:
    """Return that a belief stands still though observations that differ come; empty where it moves.

    Where all observations are the same, a belief that stands still may well be right; so may one that is all but sure.

    Args:
        seen: The last observations, `_SEEN` at most.
        observation: Names an observation.
        state: Names a state.
    """
    if len(seen) < _FEW or seen[-1].time - seen[0].time < _STILL or len({each.state for each in seen}) > 1:
        return ""
    chances = [each.chance for each in seen]
    tally = Counter(each.observation for each in seen).most_common(3)
    if max(chances) >= _SURE or max(chances) - min(chances) >= _MOVED or len(tally) < 2 or tally[1][1] < _RARE:
        return ""
    came = ", ".join(f"{observation(symbol)} {count} times" for symbol, count in tally)
    return f"observations differ ({came}); it stays at {100 * seen[-1].chance:.4g} % for {state(seen[-1].state)}"


def _words(seconds: float) -> str:
    if seconds < 10:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds // 60:.0f} min {seconds % 60:.0f} s"


Judged = tuple[dict[str, Found], float]
"""Findings of a rule, by the action or factor, and when it may change its mind though nothing happens."""
NOTHING: Judged = ({}, inf)


class Told(NamedTuple):
    """That a judgement begins, or that it is over.

    Attributes:
        time: In nanoseconds.
        status: ``begins`` or ``over``.
        number: The spell's, counted from 1 on.
        rule: The rule.
        of: The action or factor that it is of; empty for the whole.
        text: The judgement as it began, in words.
    """

    time: int
    status: Literal["begins", "over"]
    number: int
    rule: str
    of: str
    text: str


class Spell(msgspec.Struct, array_like=True):
    """Some time over which a rule names something.

    Attributes:
        number: Counted from 1 on.
        edges: From when on it names that, until when, from when on again.
        found: Its findings by their times.
    """

    number: int
    edges: list[int]
    found: list[tuple[int, Found]]

    def update(self, time: int, found: Found, *, whole: bool) -> None:
        """Take a later finding; of large counts each hundredth part is kept."""
        _, last = self.found[-1]
        if found.times - last.times > last.times // 100:
            self.found.append((time, found._replace(since=min(last.since, found.since))))
            del self.found[: 0 if whole else -1]

    def at(self, time: int) -> tuple[Found, int | None]:
        """Return the finding by a time, and since when that is over; None where it is not."""
        place = bisect_right(self.edges, time)
        _, found = self.found[max(0, bisect_right(self.found, time, key=itemgetter(0)) - 1)]
        return found, None if place % 2 else self.edges[place - 1]


class Spells:
    """Keeps the spells of all rules that its class names.

    Each rule is a method of its name, which returns what it names at a time, as `RULES` says.

    Args:
        tell: Told of each beginning and end.
        whole: Keep all spells; else the last of each rule and subject.

    Attributes:
        named: All spells, by rule and subject.
        gap: A break of so many nanoseconds at most ends no spell.
    """

    RULES: ClassVar[tuple[str, ...]]

    def __init__(self, tell: Callable[[Told], object], *, whole: bool = True) -> None:
        self.named: dict[tuple[str, str], list[Spell]] = {}
        self._open: dict[tuple[str, str], Spell] = {}
        self._breaks: dict[tuple[str, str], tuple[Spell, int]] = {}
        self._rules = {rule: getattr(self, f"_{rule.replace('-', '_')}") for rule in self.RULES}
        self.gap = _WINDOW
        self._tell, self._whole = tell, whole
        self._due: dict[str, float] = dict.fromkeys(self.RULES, inf)
        self._next = inf
        self._judged = -inf
        self._number = 0

    def has(self, rule: str) -> bool:
        """Whether a rule names something."""
        return bool(self._open) and any(key[0] == rule for key in self._open)

    def ask(self, time: float, *rules: str) -> None:
        """Ask rules about a time once all messages until then have come; late ones are judged with the rest."""
        time = max(time, self._judged)
        for rule in rules:
            self._due[rule] = min(self._due[rule], time)
        self._next = min(self._next, time)

    def settle(self, until: float) -> None:
        """Judge all times before one."""
        while self._next < until:
            time = self._judged = self._next
            for rule, due in self._due.items():
                if due <= time:
                    self._judge(rule, int(time))
            self._next = min(self._due.values())
        for (rule, of), (spell, end) in list(self._breaks.items()):
            if until - end > self.gap:
                del self._breaks[rule, of]
                self._tell(Told(end, "over", spell.number, rule, of, ""))

    def finish(self, time: int) -> None:
        """Judge all until a time, which nothing follows: a judgement that lasts then stays so."""
        self.settle(time + 1)
        self._next = inf
        self.settle(inf)

    def at(self, time: int) -> Iterable[tuple[str, str, Found, int | None]]:
        """Yield each rule and subject with its finding by a time, and when that was over."""
        for (rule, of), spells in self.named.items():
            place = bisect_right(spells, time, key=lambda spell: spell.edges[0])
            if place:
                yield (rule, of, *spells[place - 1].at(time))

    def _judge(self, rule: str, time: int) -> None:
        """Ask a rule, and note where its findings begin, change and end."""
        found, self._due[rule] = self._rules[rule](time)
        for key in [key for key in self._open if key[0] == rule and key[1] not in found]:
            spell = self._open.pop(key)
            spell.edges.append(time)
            self._breaks[key] = spell, time
        for of, each in found.items():
            key = rule, of
            kept, end = (self._open[key], time) if key in self._open else self._breaks.pop(key, (None, 0))
            if kept is not None and time - end > self.gap:
                self._tell(Told(end, "over", kept.number, rule, of, ""))
                kept = None
            if kept is None:
                self._number += 1
                kept = Spell(self._number, [time], [(time, each)])
                self.named.setdefault(key, []).append(kept)
                del self.named[key][: 0 if self._whole else -1]
                self._tell(Told(time, "begins", kept.number, rule, of, each.text))
            elif key not in self._open:
                kept.edges.append(time)
            kept.update(time, each, whole=self._whole)
            self._open[key] = kept


class _Ends(msgspec.Struct):
    """How the lives of an action have ended."""

    failed: int = 0
    succeeded: int = 0  # of plain functions nobody hears that they succeed
    first: int = 0  # when it failed first
    row: int = 0  # how often it failed in a row
    since: int = 0  # since when
    last: deque[bool] = msgspec.field(default_factory=partial(deque, maxlen=_LAST))  # whether each end was a failure
    cut: deque[int] = msgspec.field(default_factory=partial(deque, maxlen=_CUT))  # when it was pre-empted, in a row
    plain: deque[int] = msgspec.field(default_factory=partial(deque, maxlen=_PLAIN))  # when a plain function failed
    detail: str = ""  # the last failure


class _Series:
    """The loss of likelihood against the entropy that the model itself expects, over the last steps."""

    __slots__ = ("excess", "terms", "variance")

    def __init__(self) -> None:
        self.terms: deque[tuple[int, float, float]] = deque()
        self.excess = self.variance = 0.0

    def add(self, time: int, chances: Any, place: int) -> None:
        """Take an outcome, by its place among the probabilities of all."""
        logs = np.maximum(np.log(np.maximum(chances, 1e-300)), _FLOOR)
        mean = float(chances @ logs)
        variance = float(chances @ (logs * logs)) - mean * mean
        self.terms.append((time, mean - float(logs[place]), variance))
        _, before, varied = self.terms.popleft() if len(self.terms) > _SERIES else (0, 0.0, 0.0)
        self.excess += self.terms[-1][1] - before
        self.variance += variance - varied

    def found(self) -> Found | None:
        """Return that outcomes contradict the model; None where they do not."""
        count = len(self.terms)
        if self.excess < max(_EXCESS * count, _NATS + _DEVIATIONS * sqrt(max(0.0, self.variance))):
            return None
        rate = exp(self.excess / count)
        told = f"each of the last {count} is {rate:.2g} times less likely than the model expects"
        return Found(count, self.terms[0][0], "observations contradict its belief", told)


class Judge(Spells):
    """Judges an ensemble by its messages, which come in the order of their times.

    Attributes:
        known: Its names, and the model that it decides by.
        living: The lives that have begun and not ended, by their numbers.
        cut: When actions were pre-empted last.
    """

    RULES = (
        *("safe", "fails", "hangs", "pre-empted", "repeats", "waits", "impossible", "contradicts"),
        *("stuck", "unmoved", "same", "idle", "shielded", "late"),
    )

    def __init__(self, known: Known, tell: Callable[[Told], object], *, whole: bool = True) -> None:
        self.known = known
        self.living: dict[int, ActionLife] = {}
        self.cut: deque[int] = deque(maxlen=_CUT)
        self._mode: Mode | None = None
        self._ended: deque[Ended] = deque(maxlen=KEPT)
        self._ends: defaultdict[str, _Ends] = defaultdict(_Ends)
        self._again: dict[str, tuple[int, int, deque[tuple[int, int]]]] = {}
        self._last: Decision | None = None
        self._alike: tuple[Any, int, int] = (None, 0, 0)
        self._seen: deque[Seen] = deque(maxlen=_SEEN)
        self._still = 0  # how many of the last ones may have stood still, which is told cheaply
        self._want: Fault | None = None
        self._rest: Idle | None = None
        self._missed: deque[tuple[int, int]] = deque()
        self._replaced: deque[bool] = deque(maxlen=_STEPS)
        self._evidence = evidence = _Evidence(self)
        self._impossible, self._contradicts, self._stuck = evidence.impossible, evidence.contradicts, evidence.stuck
        super().__init__(tell, whole=whole)

    # -- Messages ------------------------------------------------------------------------------------------------

    def mode(self, mode: Mode) -> None:
        """Take another mode."""
        self._mode = mode
        self.ask(mode.time, "safe", "repeats", "hangs", "unmoved", "waits")

    def idle(self, idle: Idle) -> None:
        """Take that it is idle, or no longer."""
        self._rest = idle if idle.idle and not idle.intended else None
        self.ask(idle.time, "idle")

    def fault(self, fault: Fault) -> None:
        """Take that it waits for its input."""
        self._want = fault
        self.ask(fault.time, "waits")

    def missed(self, time: int, count: int) -> None:
        """Take how many ticks were missed, as was seen at a time."""
        self._missed.append((time, count))
        self.ask(time, "late")

    def decide(self, decision: Decision, count: int, repeats: int) -> None:
        """Take a decision.

        Args:
            decision: The decision.
            count: How many it stands for: those since the one before, with itself.
            repeats: How many of these were made only because an action had ended.
        """
        time, name, before, ask = decision.time, decision.action_name, self._last, self.ask
        if repeats > 1 and (before is None or before.action_name != name):
            repeats = 1  # of the others it is not known for which action they were
        if repeats:
            since, total, times = self._again.get(name, (time, 0, deque()))
            if times and times[-1][0] <= time - _WINDOW:
                since, total = time, 0
            times.append((time, repeats))
            self._again[name] = since, total + repeats, times
        if name in self._again or self.has("repeats"):
            ask(time, "repeats")
        if self._want is not None:
            self._want = None
            ask(time, "waits")
        if decision.wanted is not None or self._replaced:
            self._replaced.append(decision.wanted is not None)
            ask(time, "shielded")
        key = name, decision.state, decision.observation
        _, alike, since = self._alike
        if key != self._alike[0] or not repeats:
            alike, since = 0, time
        alike += repeats
        self._alike = key, alike, since
        if alike >= _ALIKE or self.has("same"):
            ask(time, "same")
        self._last = decision
        self._observe(decision)
        self._evidence.take(decision, count)

    def _observe(self, decision: Decision) -> None:
        """Take the observation and the belief of a decision."""
        found = None if decision.observation is None else likeliest(decision.belief)
        if found is None:
            return
        before = self._seen[-1] if self._seen else None
        moved = before is not None and (found[0] != before.state or abs(found[1] - before.chance) >= _MOVED)
        self._still = 1 if moved else self._still + 1
        self._seen.append(Seen(decision.time / 1e9, decision.observation, *found))
        if self._still >= len(self._seen) >= _FEW or self.has("unmoved"):
            self.ask(decision.time, "unmoved")

    def live(self, life: ActionLife) -> None:
        """Take that an action begins or has ended."""
        time, living = life.time, self.living
        if life.status == "running":
            living[life.life] = life
            self.ask(time + _SHORT, "hangs")
            return
        begun = living.pop(life.life, life)
        if life.action != SAFE_ACTION:
            self._end(life, time - begun.time)
        oldest = next(iter(living.values()), life)  # the usual time changes for those that last
        if self.has("hangs") or time - oldest.time >= _SHORT:
            self.ask(time, "hangs")

    def _end(self, life: ActionLife, lasted: int) -> None:
        """Count how an action has ended after some nanoseconds."""
        time, ends = life.time, self._ends[life.action]
        if lasted or life.status != "succeeded":  # else a plain function, of whose success nobody hears live
            self._ended.append(Ended(life.action, lasted / 1e9, life.status))
        if life.status == "preempted":
            self.cut.append(time)
            if lasted <= _WINDOW:
                ends.cut.append(time)
            else:
                ends.cut.clear()
            self.ask(time, "pre-empted")
            return
        ends.cut.clear()
        if life.status == "succeeded":
            ends.succeeded += bool(lasted)
            ends.row = 0
        else:
            ends.failed += 1
            ends.first = ends.first or time
            ends.since = ends.since if ends.row else time
            ends.row += 1
            ends.detail = f"{life.status.replace('_', ' ')}{': ' * bool(life.detail)}{life.detail}"
            if not lasted:
                ends.plain.append(time)
        ends.last.append(life.status != "succeeded")
        if ends.failed:
            self.ask(time, "fails")
        if self.has("pre-empted"):
            self.ask(time, "pre-empted")

    # -- Rules ---------------------------------------------------------------------------------------------------

    @property
    def _decides(self) -> bool:
        """Whether the mode lets it decide."""
        return self._mode is not None and self._mode.mode == "deciding"

    def _safe(self, _: int) -> Judged:
        mode = self._mode
        if mode is None or mode.mode != "safe" or all(cause.kind == "end" for cause in mode.causes):
            return NOTHING
        causes = "; ".join(f"{cause.kind}: {cause.detail}" for cause in mode.causes)
        kind = mode.causes[0].kind if mode.causes else ""
        remedy = KINDS[kind].remedy if kind in KINDS else ""
        return {"": Found(1, mode.since, f"is safe{f' ({kind})' * bool(kind)}", causes, remedy)}, inf

    def _fails(self, time: int) -> Judged:
        found, due = {}, inf
        for action, ends in self._ends.items():
            if not ends.failed:
                continue
            row, since = ends.row, ends.since
            if ends.plain:
                if len(ends.plain) == _PLAIN and ends.plain[0] > time - _MINUTE:
                    found[action] = Found(ends.failed, since, f"{action} has failed {ends.failed} times", ends.detail)
                    due = min(due, ends.plain[0] + _MINUTE)
            elif not ends.succeeded and ends.failed >= _NEVER:
                text = f"{action} has failed {ends.failed} times, never succeeded"
                found[action] = Found(ends.failed, ends.first, text, ends.detail)
            elif row >= _ROW:
                found[action] = Found(row, since, f"{action} has failed {row} times in a row", ends.detail)
            elif sum(ends.last) >= _MANY:
                text = f"{action} fails: {sum(ends.last)} of its last {len(ends.last)} times"
                found[action] = Found(ends.failed, ends.first, text, ends.detail)
        return found, due

    def _pre_empted(self, time: int) -> Judged:
        if not any(ends.succeeded for ends in self._ends.values()):
            return NOTHING  # in an ensemble in which others end all actions, that is their end
        found, due = {}, inf
        for action, ends in self._ends.items():
            cut = ends.cut
            if len(cut) == _CUT and cut[0] > time - _MINUTE and action not in self.known.composed:
                told = "each time within five seconds"
                never = "" if ends.succeeded else ", never succeeded"
                text = f"{action} is pre-empted again and again{never}"
                found[action] = Found(_CUT, cut[0], text, f"the last {_CUT} times {told}")
                due = min(due, cut[0] + _MINUTE)
        return found, due

    def _repeats(self, time: int) -> Judged:
        name = "" if self._last is None else self._last.action_name
        if name not in self._again or not self._decides:
            return NOTHING
        since, total, times = self._again[name]
        while times and times[0][0] <= time - _WINDOW:
            times.popleft()
        if sum(count for _, count in times) < _OFTEN:
            return NOTHING
        text = f"decided {name} {total} times, each time because it had just ended"
        place, count = 0, sum(count for _, count in times)  # the earliest entry without which there are too few
        while count - times[place][1] >= _OFTEN:
            count -= times[place][1]
            place += 1
        return {name: Found(total, since, text)}, times[place][0] + _WINDOW

    def _hangs(self, time: int) -> Judged:
        if not self._decides:
            return NOTHING
        found: dict[str, Found] = {}
        due = inf
        for life in self.living.values():
            name = life.action
            if name in self.known.composed or name == SAFE_ACTION:
                continue
            when: float = life.time + _SHORT
            usual, limit = "", SHORT
            if when <= time:
                limit, usual = lasts_long(name, self._ended)
                when = limit if limit == inf else life.time + ceil(limit * 1e9)
            if when > time:
                due = min(due, when)
            else:
                text = f"{name} has lasted for more than {_words(limit)}"
                found.setdefault(name, Found(1, life.time, text, usual))
        return found, due

    def _unmoved(self, time: int) -> Judged:
        seen = self._seen
        end = round(seen[-1].time * 1e9) + _WINDOW if seen else 0
        if len(seen) < _FEW or time >= end or not self._decides:
            return NOTHING
        told = unmoved([*seen], self.known.observed, self.known.state)
        since = round(seen[0].time * 1e9)
        return ({"": Found(len(seen), since, "the belief does not move", told)}, end) if told else NOTHING

    def _same(self, time: int) -> Judged:
        key, count, since = self._alike
        if self._evidence.model is not None or count < _ALIKE or time - since < _MINUTE:
            return NOTHING
        text = f"decided {key[0]} {count} times in a row, always in the same state"
        return {key[0]: Found(count, since, text, "each time because it had ended")}, inf

    def _waits(self, time: int) -> Judged:
        fault = self._want
        if fault is None or not self._decides:
            return NOTHING
        if time < fault.time + _SHORT:
            return {}, fault.time + _SHORT
        return {"": Found(1, fault.time, "cannot decide", fault.detail)}, inf

    def _idle(self, time: int) -> Judged:
        idle = self._rest
        if idle is None:
            return NOTHING
        if time < idle.since + _IDLE:
            return {}, idle.since + _IDLE
        ends, last = self._ends[idle.action], self._last
        still = "" if last is None or last.state is None else f", {at_state(self.known.space, last.state)} as before"
        why = f"{idle.action} {ends.detail if ends.row else 'has ended'}{still}; nothing decides again"
        remedy = "Correct its callback; `on_failed_action` says what follows a failure." if ends.row else ""
        return {"": Found(1, idle.since, "has nothing to do", why if idle.action else "", remedy)}, inf

    def _shielded(self, time: int) -> Judged:
        count = sum(self._replaced)
        if count < 10:
            return NOTHING
        text = "its shield decides in place of its policy"
        return {"": Found(count, time, text, f"in {count} of the last {len(self._replaced)} decisions")}, inf

    def _late(self, time: int) -> Judged:
        missed = self._missed
        while missed and missed[0][0] <= time - _TICKS:
            missed.popleft()
        count = sum(each for _, each in missed)
        if count < _MISSED:
            return NOTHING
        return {"": Found(count, missed[0][0], f"missed {count} ticks within 10 s")}, missed[0][0] + _TICKS


class _Evidence:
    """Holds the decisions of an ensemble against its model."""

    def __init__(self, judge: Judge) -> None:
        self._judge = judge
        self._origin: tuple[int, int] | None = None  # the last state that counts, and the action decided there
        self._at: tuple[int, int, int] | None = None  # the present state, the action decided last, and since when
        self._steps: deque[tuple[int, int, int] | None] = deque(maxlen=_STEPS)
        self._began = 0
        self._series = _Series()
        self._kept: dict[str, tuple[int, int, float, Any]] = {}  # by factor: since when, steps, nats, its value
        self._rows: dict[tuple[int, int], Any] = {}
        self._before: Decision | None = None

    @property
    def model(self) -> Any:
        """The model that it decides by; None where there is none, or it is large."""
        controller = self._judge.known.controller
        model = None if controller is None else controller.model
        if model is None or (states := len(model.state_space)) > _LARGE:
            return None
        return model if model.is_flattened or states * states * len(model.action_space) <= _SMALL else None

    def take(self, decision: Decision, count: int) -> None:
        """Take a decision, which stands for several where nobody knows how they followed each other."""
        model, before = self.model, self._before
        self._before = decision
        fresh = count != 1 or decision.cause in {"start", "resume", "reset", "episode", "release", "team", "belief"}
        if fresh:
            self._origin = self._at = None
            self._kept.clear()
        if model is None:
            return
        with suppress(ModelError, IndexError, ValueError):  # a model of other sizes than the decisions
            if decision.state is not None:
                self._move(model, decision)
            elif not fresh and before is not None and isinstance(decision.observation, int):
                self._see(model, before, decision)

    # -- States ----------------------------------------------------------------------------------------------------

    def _move(self, model: Any, decision: Decision) -> None:
        """Take the state of a decision; the state before counts once it has lasted."""
        state, time, at, steps = decision.state, decision.time, self._at, decision.cause != "state"
        assert state is not None
        if at is None:
            self._at = state, decision.action, time
            return
        if steps or time - at[2] >= _SETTLES:  # the present state has lasted, or this is a step of the model
            if self._origin is not None and self._origin[0] != at[0]:
                self._step(model, *self._origin, at[0], at[2], moved=True)
            self._origin = at[:2]
        if state == at[0]:
            if steps and decision.cause in {"again", "tick"} and self._origin is not None:
                self._step(model, state, at[1], state, time, moved=False)
            self._at = state, decision.action, at[2]
        else:
            self._at = state, decision.action, time

    def _step(self, model: Any, state: int, action: int, after: int, time: int, *, moved: bool) -> None:
        """Take a step of the model: a change of the state, or that it stayed."""
        states, stays, factors = self._row(model, state, action)
        place = int(np.searchsorted(states, after))
        possible = place < len(states) and states[place] == after
        ask = self._judge.ask
        if moved:
            self._began = self._began or time
            self._steps.append(None if possible else (state, action, after))
            if not possible or self._judge.has("impossible"):
                ask(time, "impossible")
        space = model.state_space
        for factor, before, value in zip(space.factors, space.unravel(state), space.unravel(after), strict=True):
            name, here = factor.name, factor.names[value]
            since, steps, nats, _ = self._kept.get(name, (time, 0, 0.0, here))
            if before != value:
                self._kept[name] = time, 0, 0.0, here
            if before != value or time in self._judge.cut:  # of an action that was pre-empted it is too early to say
                continue
            chance = factors[name]
            if moved:  # given that something has changed
                chance = (chance - stays) / (1 - stays) if stays < 1 else 1.0
            self._kept[name] = since, steps + 1, nats - max(log(max(chance, 1e-300)), log(0.01)), here
        ask(time, "stuck")

    def _row(self, model: Any, state: int, action: int) -> tuple[Any, float, dict[str, float]]:
        """Return the states that may follow, the probability of staying, and that of each factor to stay."""
        row = self._rows.get((state, action))
        if row is None:
            whole = np.asarray(model.transition(action, state))
            states = np.flatnonzero(whole)
            chances, space = whole[states], model.state_space
            parts = np.unravel_index(states, space.shape)
            own = space.unravel(state)
            factors = {
                factor.name: float(chances[part == value].sum())
                for factor, part, value in zip(space.factors, parts, own, strict=True)
            }
            if len(self._rows) >= _LARGE:
                self._rows.clear()
            row = self._rows[state, action] = states, float(whole[state]), factors
        return row

    def impossible(self, _: int) -> Judged:
        wrong, model = [each for each in self._steps if each is not None], self.model
        if model is None or len(wrong) < max(_IMPOSSIBLE, _FIFTH * len(self._steps)):
            return NOTHING
        (state, action, after), most = Counter(wrong).most_common(1)[0]
        names = model.state_space.names
        told = f"{most} times {names[state]} → {names[after]} by {model.action_space.names[action]}"
        text = f"{len(wrong)} of its last {len(self._steps)} changes of state are impossible by its model"
        return {"": Found(len(wrong), self._began, text, told)}, inf

    # -- Observations ----------------------------------------------------------------------------------------------

    def _see(self, model: Any, before: Decision, decision: Decision) -> None:
        """Take an observation, of which the belief before and its action tell the probabilities."""
        pomdp = model.pomdp
        belief = None if before.observation is None else before.belief  # live, none is kept without one
        if pomdp is None or pomdp.event_observations or pomdp.waits or not isinstance(belief, np.ndarray):
            return
        time, symbol = decision.time, decision.observation
        assert isinstance(symbol, int)
        following = belief @ pomdp.transition_matrix(before.action)
        chances = np.asarray(following @ pomdp.observation_matrix(before.action)).ravel()
        self._series.add(time, chances, symbol)
        since, steps, nats, last = self._kept.get("", (time, 0, 0.0, None))
        if symbol != last:
            since, steps, nats = time, 0, 0.0
        self._kept[""] = since, steps + 1, nats - max(log(max(float(chances[symbol]), 1e-300)), log(0.01)), symbol
        self._judge.ask(time, "contradicts", "stuck")

    def contradicts(self, _: int) -> Judged:
        found = self._series.found()
        return NOTHING if found is None else ({"": found}, inf)

    def stuck(self, time: int) -> Judged:
        found = {}
        for name, (since, steps, nats, value) in self._kept.items():
            if nats >= _CHANCE and time - since >= _SHORT:
                what = f"{name} stays {value}" if name else f"observes {self._judge.known.observed(value)} alone"
                text = f"{what}, {steps} times in a row"
                found[name] = Found(steps, since, text, f"its model gives that one chance in 10^{nats / log(10):.0f}")
        return found, inf


_NAMED = re.compile("'([^']+)'")


class RunJudge(Spells):
    """Judges faults, predicates, and the agents of a team.

    Attributes:
        held_for: Nanoseconds for which formulas of predicates must have been true, by name.
    """

    RULES = ("apart", "flickers", "disagrees", "late", "faults")

    def __init__(self, tell: Callable[[Told], object], *, whole: bool = True) -> None:
        self._told: dict[tuple[str, str], tuple[int, int, deque[Fault]]] = {}
        self._gone: dict[str, tuple[int, str]] = {}
        self._changes: dict[str, tuple[bool | None, int, int, deque[int]]] = {}
        self.held_for: Mapping[str, int] = {}
        self._disagrees, self._late, self._faults = (partial(self._by_faults, each) for each in self.RULES[2:])
        super().__init__(tell, whole=whole)

    def fault(self, fault: Fault) -> None:
        """Take a fault."""
        self.settle(fault.time)
        if fault.kind in {"missing_teammate", "lost_teammate"}:
            for agent in _NAMED.findall(fault.detail.partition(" of team ")[0]):
                self._gone.setdefault(agent, (fault.time, "was never met" if fault.kind[0] == "m" else "is lost"))
            self.ask(fault.time, "apart")
        if fault.kind in _ELSEWHERE:
            return
        rule, need = _FAULTS.get(fault.kind, ("faults", 5))
        since, count, last = self._told.get((fault.source, fault.kind), (fault.time, 0, deque(maxlen=need)))
        if last and last[-1].time <= fault.time - _MINUTE:
            since, count = fault.time, 0
        last.append(fault)
        self._told[fault.source, fault.kind] = since, count + 1, last
        self.ask(fault.time, rule)

    def seen(self, time: int, agent: str, live: Collection[str]) -> None:
        """Take which agents of the team are live, as one of them sees it at a time, itself among them."""
        self.settle(time)
        back = [each for each in self._gone if each in live and each != agent]
        for each in back:
            del self._gone[each]
        if back:
            self.ask(time, "apart")

    def change(self, time: int, predicate: str, value: bool | None) -> None:
        """Take the value of a predicate at a time, changed or not."""
        self.settle(time)
        known = self._changes.get(predicate)
        if known is None:
            self._changes[predicate] = value, 0, time, deque(maxlen=_CHANGES)
            return
        before, count, since, times = known
        if before is value:
            return
        if times and times[-1] <= time - self._period(predicate):
            count, since = 0, time
        times.append(time)
        self._changes[predicate] = value, count + 1, since, times
        if len(times) == _CHANGES and times[0] > time - self._period(predicate):
            self.ask(time, "flickers")

    def _period(self, predicate: str) -> int:
        """Return the nanoseconds in which ten changes are too many."""
        return _CHANGES * max(_PERIOD, self.held_for.get(predicate, 0))

    def _flickers(self, time: int) -> Judged:
        found, due = {}, inf
        for predicate, (_, count, since, times) in self._changes.items():
            period = self._period(predicate)
            if len(times) == _CHANGES and times[0] > time - period:
                rate = (_CHANGES - 1) * 1e9 / max(1, times[-1] - times[0])
                held = self.held_for.get(predicate, 0)
                told = f"{rate:.3g} changes a second{f'; it is held for {held / 1e9:g} s' * bool(held)}"
                found[predicate] = Found(count, since, f"flickers: it has changed {count} times", told)
                due = min(due, times[0] + period)
        return found, due

    def _apart(self, _: int) -> Judged:
        return {
            agent: Found(1, since, f"{how}: the team is apart", f"agent {agent!r} {how}")
            for agent, (since, how) in self._gone.items()
        }, inf

    def _by_faults(self, rule: str, time: int) -> Judged:
        found, due = {}, inf
        for (source, kind), (since, count, last) in self._told.items():
            is_of = _FAULTS.get(kind, ("faults", 5))[0] == rule and len(last) == last.maxlen
            if is_of and last[0].time > time - _MINUTE:
                text = f"{count} {'fault' if count == 1 else 'faults'} of the kind {kind}"
                remedy = KINDS[kind].remedy if kind in KINDS else ""
                found[f"{source}: {kind}"] = Found(count, since, text, last[-1].detail, remedy)
                due = min(due, last[0].time + _MINUTE)
        return found, due
