"""The player of a replay: it answers as the record does, and compares decisions."""

from __future__ import annotations

import asyncio
import math
from collections import Counter, defaultdict, deque
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import Error
from mdm.messages import Decision
from mdm.runtime.observing import Choices, Observer
from mdm.stimuli import (
    Began,
    Behind,
    Cut,
    Delays,
    Finished,
    GoesOn,
    Kept,
    Lasts,
    Late,
    Opened,
    Over,
    Raised,
    Said,
    Stimulus,
    Ticked,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence

    from mdm.actors.actions.action_layer import ActionLayer
    from mdm.runtime.observing import Deciding
    from mdm.runtime.time.scheduler import Ticker
    from mdm.runtime.work import Work


class Difference(msgspec.Struct, frozen=True):
    """A decision that was not repeated as it was recorded.

    Attributes:
        number: The number of the recorded decision, from 0; of one that only the replay made, of the next.
        recorded: The decision of the record; None where the replay alone has made one.
        replayed: That of the replay; None where it made none.
        fields: The names of the fields that differ.
        since: The stimuli before it, the last one last.
    """

    number: int
    recorded: Decision | None
    replayed: Decision | None
    fields: tuple[str, ...]
    since: tuple[Stimulus, ...]

    def describe(self, epoch: int = 0) -> str:
        """Return the difference in words, over several lines; times in seconds since an epoch in nanoseconds."""
        recorded, replayed = self.recorded, self.replayed
        known = recorded if recorded is not None else replayed
        assert known is not None
        at = (known.time - epoch) / 1e9
        if replayed is None:
            text = (
                f"decision {self.number}: {known.ensemble!r} decided {known.action_name!r} at {at:.6f} s, and not now"
            )
        elif recorded is None:
            text = (
                f"decision {self.number}: {known.ensemble!r} decides {known.action_name!r} at {at:.6f} s, and did not"
            )
        else:
            told = "; ".join(
                f"{field} {_short(recorded, field)}, now {_short(replayed, field)}" for field in self.fields
            )
            text = f"decision {self.number}, of {known.ensemble!r} at {at:.6f} s: {told}"
        lines = [text, *(f"  before it: {_told(stimulus, epoch)}" for stimulus in self.since)]
        return "\n".join(lines)


def unlike(recorded: Decision, replayed: Decision, tolerance: float) -> tuple[str, ...]:
    """Return the names of the fields of two decisions that differ; numbers by more than a tolerance."""
    found = [
        field
        for field in ("time", "ensemble", "epoch", "cause", "state", "observation", "action", "wanted")
        if getattr(recorded, field) != getattr(replayed, field)
    ]
    if not _alike(recorded.reward, replayed.reward, tolerance):
        found.append("reward")
    before, now = recorded.belief, replayed.belief
    if before is not None and (now is None or len(now) != len(before) or not _close(before, now, tolerance)):
        found.append("belief")
    return tuple(found)


def _alike(one: float | None, other: float | None, tolerance: float) -> bool:
    if one is None or other is None:
        return one is other
    return one == other or abs(one - other) <= tolerance or (math.isnan(one) and math.isnan(other))


def _close(one: Any, other: Any, tolerance: float) -> bool:
    return bool(np.array_equal(one, other) or (tolerance and np.max(np.abs(np.asarray(one) - other)) <= tolerance))


def _short(decision: Decision, field: str) -> str:
    value = getattr(decision, {"action": "action_name", "wanted": "wanted_name"}.get(field, field))
    if isinstance(value, np.ndarray):
        best = int(np.argmax(value))
        return f"{value[best]:.12g} of state {best}"
    return repr(value)


def _told(stimulus: Any, epoch: int) -> str:
    facts = {name: value for name, value in msgspec.structs.asdict(stimulus).items() if value not in ("", 0, None)}
    at = (facts.pop("time", epoch) - epoch) / 1e9
    facts = {name: f"{len(value)} bytes" if isinstance(value, bytes) else value for name, value in facts.items()}
    kind = type(stimulus).__name__.lower()
    return f"{at:.6f} s, {kind} " + ", ".join(f"{name} {value}" for name, value in facts.items())


_SINCE = 5
_AT_ONCE = 1000
"""Lives of an ensemble at one instant of a replay that differs, from which on nothing follows from their ends."""
_EVENTS = ("state", "observation")
"""Causes of decisions by events, and not at ticks."""


class Player(Choices, Observer):
    """Answers as the record does, and compares decisions with its.

    Args:
        stimuli: Those of the record.
        decisions: Those of the record, each with the time of the next stimulus behind it, by which it was made, and
            with the place of that among the stimuli.
        tolerance: By how much numbers may differ.
        most: How many differences are kept.
        now: Returns the time of the replay.
        by_time: Whether decisions are compared with those of their time, and not of their number.

    Attributes:
        differences: Those found so far, in the order of the record's decisions.
        found: The time by which each of these was found: when it was made in the replay, else when in the record.
        count: How many decisions the record has.
        made: When decisions were made in the replay, which may be behind the time of their stimulus.
        paired: The same, of those that stand beside one of the record.
        missed_by: Until when those of the record had been made that were not made.
        stopped: Whether the replay stopped before the end of the record.
    """

    name = "the replay"
    repeats = True

    def __init__(
        self,
        stimuli: Sequence[Stimulus],
        decisions: Iterable[tuple[Decision, int, int]],
        *,
        tolerance: float,
        most: int,
        now: Callable[[], int],
        by_time: bool = False,
    ) -> None:
        self.differences: list[Difference] = []
        self.found: list[int] = []
        self.count = 0
        self.made: list[int] = []
        self.paired: list[int] = []
        self.missed_by: list[int] = []
        self.stopped = False
        self._now = now
        self.opened = 0
        self.stand_ins: dict[tuple[str, int], tuple[StandIn, Work]] = {}
        self.tickers: dict[tuple[str, float], Ticker] = {}
        # The rates of each actor that ticked, and the ensembles that decided when something happened.
        self._rates: dict[str, set[float]] = defaultdict(set)
        self._eventful: set[str] = set()
        self.say: Callable[[Said], None] = lambda _: None
        # What users' handlers said within turns, and was not said yet, each with the ticks before it; and those so far.
        self.turns: deque[tuple[Said, int]] = deque()
        self.ticks = 0
        # Where turns were cut short, and have not been yet.
        self.cuts = deque(each for each in stimuli if isinstance(each, Cut))
        # From when on the run was ending, where that began within a turn: what that decided further is not recorded.
        within = (each.time for each in stimuli if isinstance(each, Finished) and each.within)
        self._ending = next(within, math.inf)
        self.since: deque[Stimulus] = deque(maxlen=_SINCE)
        self._tolerance, self._most, self._by_time = tolerance, most, by_time
        self._expected: dict[str, deque[tuple[int, Decision, int]]] = defaultdict(deque)
        # Those that should have been made by now, and were not: what had led there, by their numbers.
        self._overdue: dict[int, tuple[Stimulus, ...]] = {}
        self._due: deque[tuple[int, Decision, int]] = deque()
        self._places: list[int] = []
        for number, (decision, by, place) in enumerate(decisions):
            self._expected[decision.ensemble].append((number, decision, by))
            self._due.append((number, decision, place))
            self._places.append(place)
            if decision.cause in _EVENTS:
                self._eventful.add(decision.ensemble)
            self.count += 1
        self._next = 0
        self._compared = False
        self._said: dict[tuple[str, int], list[Said]] = defaultdict(list)
        self._raised: dict[tuple[str, int], Raised] = {}
        self._lasting: set[tuple[str, int]] = set()
        # The bindings whose functions were seen to last, and how many unknown lives began at one instant.
        self._lasted: set[int] = set()
        self._at_once: dict[str, tuple[int, int]] = {}
        self._kept: dict[tuple[str, int], tuple[dict[str, bool | None], dict[str, int]]] = {}
        self._goes_on: dict[tuple[str, int, int], bool] = {}
        self._overs = {(it.ensemble, it.epoch, it.time, it.life) for it in stimuli if isinstance(it, Over)}
        self._delays = Delays()
        self._behind: dict[tuple[str, int, int], int] = {}
        # Decisions that came late, each with its place among the stimuli: an episode that begins within a turn has
        # others of the same epoch and time.
        self._late: dict[tuple[str, int, int], deque[tuple[int, int]]] = defaultdict(deque)
        self._begins: Counter[tuple[str, str]] = Counter()
        self._waiting: dict[tuple[str, str], asyncio.Future[None]] = {}
        self._came = asyncio.Event()
        self._steps: set[tuple[str, str]] = set()
        self._over = False
        self._draws: dict[str, str] = {}
        # Work that has not been waited for to take its first step.
        self.fresh: list[tuple[StandIn, Work]] = []
        ticks = 0
        for place, stimulus in enumerate(stimuli):
            if isinstance(stimulus, Ticked):
                ticks += 1
                self._rates[stimulus.actor].add(stimulus.rate)
            elif isinstance(stimulus, Late):
                self._late[stimulus.ensemble, stimulus.epoch, stimulus.time].append((place, stimulus.latency))
            self._sort(stimulus, ticks)

    def _sort(self, stimulus: Stimulus, ticks: int) -> None:
        """Put the answer to a question where it is found when that is asked."""
        if isinstance(stimulus, Said):
            self._sort_said(stimulus, ticks)
        elif isinstance(stimulus, Raised):
            self._raised[stimulus.ensemble, stimulus.life] = stimulus
        elif isinstance(stimulus, Lasts):
            self._lasting.add((stimulus.ensemble, stimulus.life))
        elif isinstance(stimulus, GoesOn):
            self._goes_on[stimulus.ensemble, stimulus.epoch, stimulus.time] = stimulus.answer
        elif isinstance(stimulus, Behind):
            self._behind[stimulus.actor, stimulus.time, stimulus.number] = stimulus.begin
        elif isinstance(stimulus, Kept):
            self._kept[stimulus.actor, stimulus.time] = stimulus.values, stimulus.times
        elif isinstance(stimulus, Began):
            self._begins[stimulus.actor, stimulus.step] += 1

    def _sort_said(self, said: Said, ticks: int) -> None:
        """Put a message of calls and turns where it has its place."""
        if said.where == "call":
            self._said[said.ensemble, said.life].append(said)
        elif said.where == "turn":
            self.turns.append((said, ticks))

    # -- Starts and ends -----------------------------------------------------------------------------------------------

    async def comes(self, actor: str, step: str) -> None:
        """Wait until the record comes to this step; one that it does not have is taken at once."""
        if self._over or not self._begins[actor, step]:
            return
        self._begins[actor, step] -= 1
        self._waiting[actor, step] = permit = asyncio.get_running_loop().create_future()
        self._came.set()
        await permit

    async def admit(self, stimulus: Began, seconds: float) -> bool:
        """Let an actor come to its step, once it wants to, and wait until it has; return whether it did."""
        key = (stimulus.actor, stimulus.step)
        while key not in self._waiting:
            self._came.clear()
            try:
                await asyncio.wait_for(self._came.wait(), seconds)
            except TimeoutError:
                return False
        self._waiting.pop(key).set_result(None)
        while key not in self._waiting and not self._arrived(key):  # noqa: ASYNC110 - the loop's next round counts
            await asyncio.sleep(0)
        return True

    def release(self) -> None:
        """Hold nobody any more: the record is over, and actions last until the runtime ends them."""
        self._over = True
        self.cuts.clear()
        for stand_in, _ in self.stand_ins.values():
            stand_in.release()
        for permit in self._waiting.values():
            if not permit.done():
                permit.set_result(None)

    def _arrived(self, key: tuple[str, str]) -> bool:
        arrived = key in self._steps
        self._steps.discard(key)
        return arrived

    def on_stimulus(self, stimulus: Stimulus) -> None:
        """Note that an actor has come to a step, or that a link is open."""
        if isinstance(stimulus, Began):
            self._steps.add((stimulus.actor, stimulus.step))
        elif isinstance(stimulus, Opened):
            self.opened += 1

    def kept(
        self, actor: str, values: dict[str, bool | None], times: dict[str, int], time: int
    ) -> tuple[dict[str, bool | None], dict[str, int]]:
        """Return the values that sensors had told before the actor's start."""
        return self._kept.get((actor, time), ({}, {}))

    # -- Input -----------------------------------------------------------------------------------------------------

    def counts_from(self, actor: str, time: int, begin: int) -> int:
        """Return when a delay began."""
        return self._behind.get((actor, time, self._delays.count(actor, time)), time)

    def rates(self, actor: str, rate: float, ticker: Ticker) -> None:
        """Keep a ticker, which ticks when the record does."""
        self.tickers[actor, rate] = ticker

    def unticked(self) -> str:
        """Return that an actor is to tick at times at which it did not; empty where all tick as they did."""
        for actor, rate in self.tickers:
            had = self._rates[actor]
            if had and rate not in had:
                rates = " and ".join(f"{each:g}" for each in sorted(had))
                return f"{actor!r} ticks {rate:g} times a second, and {rates} times in the record"
            if not had and actor.rpartition("/")[0] in self._eventful:
                return f"{actor!r} ticks {rate:g} times a second, and never in the record"
        return ""

    # -- Actions -----------------------------------------------------------------------------------------------------

    def acts(self, ensemble: str, layer: Any) -> None:
        """Put a stand-in in the place of each of the layer's functions."""
        acting: ActionLayer = layer
        acting.substitute(lambda binding: self._call(ensemble, acting.started, id(binding)))

    def _call(self, ensemble: str, life: int, binding: int) -> Any:
        """Repeat the call of the function of a life."""
        for said in self._said.get((ensemble, life), ()):
            self.say(said)
        raised = self._raised.get((ensemble, life))
        if raised is not None:
            if raised.unrun:
                return (None for _ in ())  # of which nothing runs, either
            raise AsRecordedError(raised.error)
        if (ensemble, life) in self._lasting:
            self._lasted.add(binding)
            return StandIn()
        return StandIn() if self._over or (self.differences and self._is_unknown(ensemble, binding)) else None

    def _is_unknown(self, ensemble: str, binding: int) -> bool:
        """Whether nobody knows how long a life lasts that the record does not have; else it ends within its call."""
        now = self._now()
        then, count = self._at_once.get(ensemble, (now, 0))
        count = count + 1 if then == now else 1
        self._at_once[ensemble] = now, count
        return binding in self._lasted or count > _AT_ONCE

    def lasts(self, ensemble: str, life: int, work: Work) -> None:
        """Know the stand-in and the work of a life."""
        stand_in = work.awaitable
        if isinstance(stand_in, StandIn):
            self.stand_ins[ensemble, life] = stand_in, work
            self.fresh.append((stand_in, work))
            if self._over or (ensemble, life) not in self._lasting:
                stand_in.release()

    def goes_on(self, ensemble: str, epoch: int, time: int, ask: Callable[[], bool]) -> bool:
        """Return the answer of the action's function."""
        return self._goes_on.get((ensemble, epoch, time), False)

    def over(self, ensemble: str, epoch: int, time: int, life: int, over: bool) -> bool:
        """Return whether the task was over; where a record does not say of which life, any task."""
        return any((ensemble, epoch, time, noted) in self._overs for noted in (life, 0))

    # -- Decisions ---------------------------------------------------------------------------------------------------

    def draw_from(self, ensemble: str, draws: str) -> None:
        """Let the policy of an ensemble draw as it did; before that starts."""
        self._draws[ensemble] = draws

    def controls(self, output: Deciding) -> None:
        """Let an ensemble's policy draw, where it does, from where it did."""
        draws = self._draws.pop(output.ensemble, "")
        if draws:
            output.draw_from(draws)

    def latency(self, ensemble: str, epoch: int, time: int, latency: int) -> int:
        """Return how late the decision was; 0 for one that the record has before the one that came late."""
        late = self._late.get((ensemble, epoch, time))
        if not late:
            return 0
        if expected := self._expected[ensemble]:
            number, decision, _ = expected[0]
            if (decision.epoch, decision.time) == (epoch, time) and self._places[number] <= late[0][0]:
                return 0
        return late.popleft()[1]

    def on_step(
        self,
        output: Deciding,
        time: int,
        epoch: int,
        cause: str,
        state: int | None,
        observation: Any,
        current: Any,
        action: int,
        reward: float | None,
    ) -> None:
        """Compare a decision with that of the record, as long as that goes on."""
        if self._compared:
            return
        belief = None if current is None else output.belief_of(current)
        name = output.name_of(action)
        made = Decision(
            *(time, output.ensemble, epoch, cause, state, observation, belief, action, name, reward),
            *output.wanted(cause, current),
        )
        now = self._now()
        expected = self._expected[output.ensemble]
        if not expected and now >= self._ending:
            return
        self.made.append(now)
        while self._by_time and expected and expected[0][1].time < time:
            number, recorded, by = expected.popleft()
            self.missed_by.append(by)
            self._differ(Difference(number, recorded, None, (), tuple(self.since)), by)
        if not expected or (self._by_time and expected[0][1].time > time):
            self._differ(Difference(self._next, None, made, (), tuple(self.since)), now)
            return
        number, recorded, _ = expected.popleft()
        self.paired.append(now)
        self._next = number + 1
        fields = unlike(recorded, made, self._tolerance)
        if self._by_time:
            fields = tuple(field for field in fields if field != "epoch")
        if fields:
            self._differ(Difference(number, recorded, made, fields, tuple(self.since)), now)

    def _differ(self, difference: Difference, by: int) -> None:
        if len(self.differences) < self._most:
            self.differences.append(difference)
            self.found.append(by)

    def comes_to(self, place: int) -> None:
        """Come to a stimulus, by its place: decisions before it are made, or late.

        One that comes late is no difference; one that never comes is one, with the stimuli that had led to it.
        """
        due = self._due
        while due and due[0][2] <= place:
            number, decision, _ = due.popleft()
            expected = self._expected[decision.ensemble]
            if expected and expected[0][0] <= number:
                self._overdue[number] = tuple(self.since)

    def missed(self, until: int, *, overdue: bool = False) -> None:
        """Count decisions of the record up to a time that were not made as missed, and compare no further ones.

        Args:
            until: The time.
            overdue: Only those whose place in the record has passed: the replay has not come to its end.
        """
        self._compared, self.stopped = True, overdue
        left = [
            item
            for expected in self._expected.values()
            for item in expected
            if (item[0] in self._overdue if overdue else item[1].time <= until)
        ]
        found = list(zip(self.differences, self.found, strict=True))
        for number, recorded, by in left:
            self.missed_by.append(by)
            found.append((Difference(number, recorded, None, (), self._overdue.get(number, tuple(self.since))), by))
        found.sort(key=lambda each: each[0].number)
        self.differences = [difference for difference, _ in found[: self._most]]
        self.found = [by for _, by in found[: self._most]]
        for expected in self._expected.values():
            expected.clear()


class AsRecordedError(Error):
    """The error of an action, as the record tells it."""


class _Command(asyncio.Future[None]):
    """Waits for the next command; whoever cancels the stand-in has no say in when that ends.

    Args:
        cancel: Called with no argument at a cancellation.
    """

    def __init__(self, cancel: Callable[[], bool]) -> None:
        super().__init__()
        self._cancel = cancel

    def cancel(self, msg: Any | None = None) -> bool:
        """Take the cancellation, and go on waiting."""
        return self._cancel()


class StandIn:
    """An awaitable in place of that of an action's function.

    It passes for a future, so that a cancellation before its first step does not end it either: the record says when it
    ends. One that is released, for the record does not say that, lasts until it is cancelled.
    """

    _asyncio_future_blocking = False

    def __init__(self) -> None:
        self._commands: deque[tuple[Callable[[], object], asyncio.Future[None]]] = deque()
        self._waiting: _Command | None = None
        self._over = False
        self._released = False

    def cancel(self, msg: Any | None = None) -> bool:
        """Take a cancellation, before the first step or later."""
        if self._released:
            self.end(asyncio.CancelledError())
        return True

    def release(self) -> None:
        """Let the next cancellation end it."""
        self._released = True

    def __await__(self) -> Generator[Any, None, None]:
        """Carry out commands until the end."""
        while not self._is_over():
            while self._commands:
                command, done = self._commands.popleft()
                try:
                    command()
                finally:
                    if not done.done():
                        done.set_result(None)
                if self._is_over():
                    return
            self._waiting = _Command(self.cancel)
            yield from self._waiting

    def _is_over(self) -> bool:
        return self._over

    async def do(self, command: Callable[[], object]) -> None:
        """Do something within the task, and wait until it is done."""
        done = asyncio.get_running_loop().create_future()
        self._commands.append((command, done))
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
        await done

    def end(self, error: BaseException | None = None) -> None:
        """End it, with an error where one is given."""

        def leave() -> None:
            self._over = True
            if error is not None:
                raise error

        self._commands.append((leave, asyncio.get_running_loop().create_future()))
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
