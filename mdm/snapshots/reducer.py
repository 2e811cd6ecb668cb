"""The reducer of a run: messages in, the state of a picture out, the same for a running system and for its record.

A running system and a record feed it the same messages, in the order of their times; causes, judgements, frames and
events follow from these alone. A record keeps all of them, so that it is shown at any of its times; of a running
system the newest are kept, as many as a rule needs.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from mdm.errors import ModelError
from mdm.messages import ActionLife, Decision, Idle, Mode
from mdm.snapshots.beliefs import belief_frame
from mdm.snapshots.events import Event, event_of, remedy_of
from mdm.snapshots.frame import CauseFrame, Detail, EnsembleFrame, LifeFrame
from mdm.snapshots.judgement import KEPT, SAFE_ACTION, Ended, Judge
from mdm.snapshots.words import (
    Wiring,
    at_state,
    cause_in_words,
    changes,
    most_frequent,
    observed,
    on_observing,
    valued,
    wired,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mdm.actors import Ensemble
    from mdm.models import Space
    from mdm.snapshots.judgement import Told

HISTORY = 8
"""Observations that are told with their times."""
_NEWEST = 64
"""Entries that are kept of a running system where no rule needs more."""
_KINDS = 1_000
"""Observations of a running system that are counted each."""
PARTS = 2_000
"""Parts of the time of a lane: there are no more pixels."""
_AHEAD = 100
"""Ends of lives behind the time that is looked at, among which that of one that goes on there is looked for."""
_BAD = ("abandoned", "timed_out", "failed")
_VALUED = 10_000
"""States up to which a policy is asked for its value."""


class Track:
    """Entries of one subject by their times.

    Args:
        newest: How many entries are kept at least; None for all.
    """

    __slots__ = ("entries", "newest", "times")

    def __init__(self, newest: int | None = None) -> None:
        self.times: Any = []
        self.entries: Any = []
        self.newest = newest

    def add(self, time: int, entry: Any) -> None:
        """Add an entry; a turn that was cut may tell its time late, which counts as the last one then."""
        self.times.append(max(time, self.times[-1]) if self.times else time)
        self.entries.append(entry)
        if self.newest is not None and len(self.times) > 2 * self.newest:
            del self.times[: -self.newest], self.entries[: -self.newest]

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


class Decided(NamedTuple):
    """A decision without its belief, how many it stands for, and how many there were with them."""

    message: Decision
    stands: int
    total: int


_SYMBOL = int | tuple[int | None, ...]
_TRACKS: dict[str, Any] = {
    "modes": Mode,
    "idles": Idle,
    "lives": tuple[ActionLife, ...],
    "decisions": Decided,
    "ends": Ended,
    "observed": _SYMBOL,
    "changes": None,
    "bars": tuple[ActionLife, ActionLife],
}
"""The tracks of a whole run, and the types of their entries."""


class Known(NamedTuple):
    """The names and wiring of an ensemble, which no message tells.

    Attributes:
        space: Its states, where they have names.
        observation: Names an observation.
        wiring: The factors of its state.
        composed: Actions that are ensembles, which last as long as they are chosen.
        controller: Its controller, where it may be asked for the return that its policy expects.
    """

    space: Space | None
    observation: Callable[[Any], str]
    wiring: Wiring = Wiring(None, {})
    composed: frozenset[str] = frozenset()
    controller: Any = None

    def state(self, state: int) -> str:
        """Return the name of a state."""
        return str(state) if self.space is None else self.space.names[state]

    def factors(self, state: int) -> tuple[tuple[str, str | None], ...]:
        """Return the factors of a state with their values; none where there is one alone that nothing tells."""
        space = self.space
        if space is None or (len(space.factors) < 2 and space.factors[0].name not in self.wiring.sources):
            return ()
        return valued(space, space.unravel(state))

    def observed(self, observation: Any) -> str:
        """Return the name of an observation; empty where there was none."""
        return "" if observation is None else self.observation(observation)


UNKNOWN = Known(None, str)


def known_of(ensemble: Ensemble, *, controller: Any) -> Known:
    """Return names and wiring of an ensemble that exists, running or not, with the controller that may be asked."""
    symbols, action = ensemble.controller.symbols, ensemble.action
    pairs = zip(action.names, action.bindings, strict=True)
    return Known(
        symbols.state_space,
        lambda observation: observed(symbols.observation_space, observation) or str(observation),
        wired(ensemble),
        frozenset([name for name, binding in pairs if binding.ensemble is not None]),
        controller,
    )


def expected_return(controller: Any, at: Any) -> float | None:
    """Return the expected return by the policy's own values, where it has some and asking costs little."""
    if controller is None or at is None or not hasattr(controller.policy, "value"):
        return None
    states = controller.symbols.num_states
    if states is None or states > _VALUED:
        return None
    try:
        return round(float(controller.policy.value(at)), 6)
    except (ModelError, TypeError, ValueError, IndexError, NotImplementedError):
        return None


class EnsembleReducer:
    """Reduces the messages of an ensemble to pictures of it.

    Args:
        path: Its path.
        tell: Called when a judgement begins, and when that is over.
        known: Its names and wiring.
        whole: Keep all, for a picture of any time; else the newest.
        epoch: The time of the run's second 0.

    Attributes:
        modes: Its modes.
        idles: When it had nothing to do, and when it had again.
        lives: The actions that lived from each change of them on.
        decisions: Its decisions, each a `Decided`.
        changes: Where one was for another action than the one before.
        ends: The ended lives of its actions, but for plain functions.
        bars: The beginnings and the ends of these lives, by their ends; of a whole run alone, as the next.
        outcomes: Where lives have ended, those of plain functions with them, by how.
        observed: The observations that were decided on.
        believes: Whether any decision has a belief.
        version: The number of messages so far.
        heard: Since when all ends of actions are heard; None where none was missed.
    """

    def __init__(
        self,
        path: str,
        tell: Callable[[str, Told], object],
        known: Known = UNKNOWN,
        *,
        whole: bool = True,
        epoch: int = 0,
    ) -> None:
        def track(newest: int = _NEWEST) -> Track:
            return Track(None if whole else newest)

        self.path = path
        self.modes, self.idles, self.lives, self.decisions = track(), track(), track(), track()
        self.ends, self.observed = track(KEPT), track(HISTORY)
        self.changes, self.bars = track(), track()
        self.outcomes: defaultdict[str, Track] = defaultdict(lambda: track(1))
        self.believes = False
        self.version = 0
        self.heard: int | None = None
        self._whole = whole
        self._epoch = epoch
        self._tally: defaultdict[Any, Track] = defaultdict(lambda: track(1))
        self.judge = Judge(known, lambda told: tell(path, told), whole=whole)

    # -- Messages ------------------------------------------------------------------------------------------------

    def add(self, message: Decision | ActionLife | Mode | Idle, count: int = 1, repeats: int | None = None) -> None:
        """Take a message.

        Args:
            message: The message.
            count: Of a decision, how many it stands for: those since the one before, with itself.
            repeats: How many of these were made only because an action had ended; by default as its cause says.
        """
        self.version += 1
        self.judge.settle(message.time)
        if isinstance(message, Decision):
            self._decide(message, count, int(message.cause == "again") if repeats is None else repeats)
        elif isinstance(message, ActionLife):
            self._live(message)
        elif isinstance(message, Mode):
            self.modes.add(message.time, message)
            self.judge.mode(message)
        else:
            self.idles.add(message.time, message)
            self.judge.idle(message)

    def _decide(self, decision: Decision, count: int, repeats: int) -> None:
        time, name, observation = decision.time, decision.action_name, decision.observation
        before = self.decisions.entries[-1] if self.decisions.entries else None
        if self._whole and (before is None or before.message.action_name != name):
            self.changes.add(time, None)
        if decision.belief is not None:  # which is read again where one looks at it
            self.believes = True
            kept = msgspec.structs.replace(decision, belief=None)
        else:
            kept = decision
        self.decisions.add(time, Decided(kept, count, count + (0 if before is None else before.total)))
        self.judge.decide(decision, count, repeats)
        if observation is not None:
            self.observed.add(time, observation)
            if self._whole or observation in self._tally or len(self._tally) < _KINDS:
                tally = self._tally[observation]
                tally.add(time, 1 + (tally.entries[-1] if tally.entries else 0))

    def _live(self, life: ActionLife) -> None:
        time, begun = life.time, self.judge.living.get(life.life, life)
        if life.status != "running":
            if self._whole:
                self.outcomes[life.status].add(time, None)
            # The life of a plain function has no length, and its decision stands for it; a safe action has none.
            if life.status != "succeeded" or begun.time != time or life.action == SAFE_ACTION:
                self.ends.add(time, Ended(life.action, (time - begun.time) / 1e9, life.status))
                if self._whole:
                    self.bars.add(time, (begun, life))
        self.judge.live(life)
        self.lives.add(time, tuple(self.judge.living.values()))

    def lose(self, life: int, time: int) -> None:
        """End a life whose end was not heard."""
        del self.judge.living[life]
        self.lives.add(time, tuple(self.judge.living.values()))
        self.version += 1

    # -- Its summary ---------------------------------------------------------------------------------------------

    def tracks(self) -> dict[str, Track]:
        """Return all of its tracks, by names."""
        found = {name: getattr(self, name) for name in _TRACKS}
        found |= {f"ended {status}": track for status, track in self.outcomes.items()}
        return found | {f"tally {msgspec.json.encode(symbol).decode()}": each for symbol, each in self._tally.items()}

    def track(self, name: str) -> tuple[Track, Any]:
        """Return the track of a name that `tracks` of some reducer has told, and the type of its entries."""
        kind, _, of = name.partition(" ")
        if kind == "ended":
            return self.outcomes[of], None
        if kind == "tally":
            return self._tally[msgspec.json.decode(of, type=_SYMBOL)], int
        return getattr(self, name), _TRACKS[name]

    # -- Pictures ------------------------------------------------------------------------------------------------

    def seconds(self, time: int) -> float:
        """Return the seconds from the run's second 0 to a time: all digits, so that a step lands on its event."""
        return (time - self._epoch) / 1e9

    def frame(self, time: int, waiting: tuple[str, ...] = ()) -> EnsembleFrame:
        """Return how the ensemble is at a time.

        Args:
            time: The time.
            waiting: The inputs or pauses that it waits for.
        """
        seconds = self.seconds
        mode: Mode | None = self.modes.at(time)
        idle: Idle | None = self.idles.at(time)
        decided: Decided | None = self.decisions.at(time)
        causes = () if mode is None else mode.causes
        return EnsembleFrame(
            mode="stopped" if mode is None else mode.mode,
            since=0.0 if mode is None else seconds(mode.since),
            causes=tuple([CauseFrame(c.kind, c.detail, seconds(c.since), remedy_of(c.kind)) for c in causes]),
            waiting=waiting,
            idle=seconds(idle.since) if idle is not None and idle.idle else None,
            live=tuple([LifeFrame(life.action, seconds(life.time)) for life in self.lives.at(time) or ()]),
            epoch=-1 if decided is None else decided.message.epoch,
            action="" if decided is None else decided.message.action_name,
            wanted="" if decided is None else decided.message.wanted_name or "",
            decisions=0 if decided is None else decided.total,
        )

    def detail(self, time: int, current: Any, **more: Any) -> Detail:
        """Return the ensemble at close range, at a time.

        Args:
            time: The time.
            current: The belief that was decided on last; None where there is none.
            more: Facts that no message tells.
        """
        known, seconds = self.judge.known, self.seconds
        place = self.decisions.place(time)
        decision: Decision | None = self.decisions.entries[place].message if place >= 0 else None
        at: Any = current if decision is None or decision.state is None else decision.state
        facts: dict[str, Any] = {}
        if decision is not None:
            facts = {"cause": self.cause(place), "decided": seconds(decision.time), "reward": decision.reward}
            if decision.state is not None:
                facts |= {"state": known.state(decision.state), "factors": known.factors(decision.state)}
        last = self.observed.last(time, HISTORY)
        history = [
            (seconds(when), known.observed(symbol))
            for when, symbol in zip(self.observed.times[last], self.observed.entries[last], strict=True)
        ]
        counts: Counter[str] = Counter()
        for symbol, track in self._tally.items():
            counts[known.observed(symbol)] += track.at(time) or 0
        facts |= {
            "observation": history[-1][1] if history else None,
            "value": expected_return(known.controller, at),
            "belief": belief_frame(current, known.space),
            "observations": tuple(history),
            "tally": most_frequent(+counts),
        }
        return Detail(**(more | facts))

    def cause(self, place: int) -> str:
        """Return the cause of a decision by its place, in words, and the action that a shield has replaced."""
        message, count, _ = self.decisions.entries[place]
        before: Decision | None = self.decisions.entries[place - 1].message if place > 0 and count == 1 else None
        ended: Ended | None = None
        if message.cause == "again" and before is not None:
            ended = self.ends.at(message.time)
            if ended is None or ended.action != before.action_name:
                # Of a plain function's end nothing is heard, if it has succeeded.
                plain = self.heard is None or before.time >= self.heard
                ended = Ended(before.action_name, 0.0, "succeeded") if plain else None
        words = cause_in_words(
            message.cause,
            observed=self.judge.known.observed(message.observation),
            changed=changes(self.judge.known.wiring, None if before is None else before.state, message.state),
            ended=ended,
        )
        return words if message.wanted is None else f"{words}; the shield took it in place of {message.wanted_name!r}"

    def lane(self, begin: int, end: int, most: int) -> Iterator[Event]:
        """Yield modes, decisions and lives of a whole run from a time to another one as events.

        Args:
            begin: The first time.
            end: The last one.
            most: Of each kind, above which those of a part of the time stand together, see `parts_of`.
        """
        seconds, replace = self.seconds, msgspec.structs.replace
        modes, decisions, changes, bars = self.modes, self.decisions, self.changes, self.bars
        for one, two in parts_of(modes.times, begin, end, most):
            yield replace(event_of(modes.entries[two - 1], seconds), count=two - one, time=seconds(modes.times[one]))
        for one, two in parts_of(decisions.times, begin, end, most):
            event = self.decision_event(two - 1, two - one)
            if two - one > 1 and changes.place(decisions.times[two - 1]) > changes.place(decisions.times[one]):
                event = replace(event, status="several")
            yield event
        ended = 0
        for one, two in parts_of(bars.times, begin, end, most):
            begun, last = bars.entries[one][0], bars.entries[two - 1][1]
            ended = two
            told = last
            for status in _BAD if two - one > 1 else ():
                if status in self.outcomes and (place := self.outcomes[status].place(last.time)) >= 0:
                    failed = bars.place(self.outcomes[status].times[place])
                    told = bars.entries[failed][1] if failed >= one else told
            about = {"count": two - one, "life": last.life, "name": told.action}
            if begun != last:
                yield replace(event_of(replace(begun, status="running"), seconds), **about)
            yield replace(event_of(told, seconds), time=seconds(last.time), **about)
        ended = ended or bisect_right(bars.times, end)
        for living in self.lives.at(end) or ():  # which may end later
            yield event_of(living, seconds)
            ends = (bars.entries[place] for place in range(ended, min(ended + _AHEAD, len(bars.times))))
            yield from [event_of(last, seconds) for begun, last in ends if begun.life == living.life][:1]

    def decision_event(self, place: int, count: int | None = None) -> Event:
        """Return a decision by its place as an event, which has no number yet.

        Args:
            place: Its place.
            count: How many it stands for, where that is another number than it was told with.
        """
        message, of, _ = self.decisions.entries[place]
        at = ""
        if message.cause != "observation" and message.state is not None:
            at = at_state(self.judge.known.space, message.state)
        elif message.cause != "observation":
            at = on_observing(self.judge.known.observed(message.observation))
        time, count = self.seconds(message.time), of if count is None else count
        mixed = "several" if of > 1 else ""  # of which the last is known
        about = {"detail": self.cause(place), "life": message.epoch, "count": count, "at": at, "status": mixed}
        return Event(0, time, "decision", self.path, message.action_name, **about)


def parts_of(times: Sequence[int], first: int, last: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield places, as the first and the one behind the last, that stand together, where there are more than so many.

    The last one before that time is the first of them, by itself: it says how the time begins.
    """
    begin, end = bisect_left(times, first), bisect_right(times, last)
    if begin:
        yield begin - 1, begin
    if end - begin <= most:
        yield from [(place, place + 1) for place in range(begin, end)]
        return
    for part in range(most):
        after = bisect_right(times, first + (last - first) * (part + 1) // most, begin, end)
        if after > begin:
            yield begin, after
            begin = after
