"""Snapshots of a recorded run at any time of it, in the shape of those of a running system.

The record is read through once; beliefs are read again where one is looked at. What a record does not keep, such as the
values of predicates, `restore` has from a replay, where the record has its configuration.
"""

from __future__ import annotations

import asyncio
import re
import zlib
from bisect import bisect_left, bisect_right
from collections import Counter, OrderedDict
from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from mdm.errors import Error
from mdm.messages import ActionLife, Decision, Fault, Idle, Journey, Mode, PoseUpdate, SensorUpdate
from mdm.models import Space
from mdm.progress import report_share
from mdm.recording.table import Names, names_of
from mdm.replay.replay import replay_predicates
from mdm.replay.retraced import retraced
from mdm.snapshots.beliefs import chances_of, entropy, marginals
from mdm.snapshots.events import event_of, predicate_event, spell_event
from mdm.snapshots.frame import Detail, Frame, PredicateScene, Scene, StatisticsFrame
from mdm.snapshots.judgement import RunJudge, Spell, Told, judged
from mdm.snapshots.picture import Picture, case_of, pictures
from mdm.snapshots.reducer import PARTS, EnsembleReducer, Known, Track, expected_return, known_of, parts_of
from mdm.snapshots.scenes import ensembles_of, floors_of, robot_at
from mdm.snapshots.summary import Summary, packed, unpack
from mdm.snapshots.why import Why, is_as_recorded, why_recorded
from mdm.stimuli import Said, Seen, Ticked
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from mdm.actors import Ensemble, PredicateManager
    from mdm.maps import Places
    from mdm.models.matrices import Vector
    from mdm.recording.reader import Record
    from mdm.replay.exchange import ReplayTransport
    from mdm.runtime import Actor
    from mdm.snapshots.events import Event
    from mdm.snapshots.frame import Judgement

Step = Literal["decision", "change", "fault", "mode", "judgement"]

_TOLD = re.compile(rb'"(?:PoseUpdate|Journey|SensorUpdate|seen)"|"missed":[1-9]')
"""Stimuli with one of these tell something here."""
_TOPICS = ("stimuli", "decisions", "lives", "modes", "faults", "idles")
_MOST = 50_000
"""Events of a kind that are shown; of more decisions one stands for several."""
_BELIEFS = 64
"""Beliefs that are kept at hand."""
POINTS = 300
"""Decisions that are told, at most: more are no wider than a line of the chart."""
_STATES = 5
"""States that have a band of their own."""
_WAY = 10
"""Decisions whose beliefs are the way of the belief in a picture."""
_SYMBOLS = 24
"""Values of all factors together up to which the probability of each is told."""
_KEPT = 64
"""States that are kept of each belief: one that is none of them is less likely than a 64th."""


_TRACKS = {"_faults": Fault, "_poses": PoseUpdate, "_journeys": Journey}
_FACTS: dict[str, Any] = {
    "believes": set[str],
    "restored": str | None,
    "told": list[tuple[str, Told]],
    "spells": dict[str, dict[tuple[str, str], list[Spell]]],
    "run": list[dict[tuple[str, str], list[Spell]]],
}
"""The facts that a summary holds beside its tracks, and their types."""


class Course(msgspec.Struct, frozen=True):
    """How an ensemble's decisions went over some time.

    Attributes:
        times: When each decision that is told was made, in seconds of the record.
        decisions: How many decisions there were in that time; those that are told stand for all.
        states: The names of the states that were likeliest in the sum, the likeliest first.
        beliefs: For each of these states, its probability at each decision; None where there was no belief.
        rewards: The expected reward of each decision; None where it is not known.
        values: The expected return from each decision on, by the policy's own values; None where it is not known.
        entropies: The entropy of each belief in bits; None where there was none.
        shares: Of the values of factors, such as ``position hall``, the probability at each decision; of few alone.
    """

    times: tuple[float, ...]
    decisions: int
    states: tuple[str, ...]
    beliefs: tuple[tuple[float | None, ...], ...]
    rewards: tuple[float | None, ...]
    values: tuple[float | None, ...]
    entropies: tuple[float | None, ...] = ()
    shares: tuple[tuple[str, tuple[float | None, ...]], ...] = ()


class RecordedRun:
    """A record, for those who look at it.

    Args:
        record: The record.
        system: The actors of the run, built from its configuration and not started, where there is one.
        title: Its title.
        summary: Its summary, where there is one: without one all of its messages are read.

    Raises:
        Error: If there is no message in it.

    Attributes:
        first: Its first second, which is 0.
        last: Its last one.
        restored: A remark on the replay that has restored predicates, or nothing; None without one.
        restorable: Whether a replay can restore predicates.
        pending: Whether another reading of it comes soon, which knows more.
        generation: Of how many readings of the record it is.
        breaks: Whether the record ends before its run did, and grows no more.
    """

    def __init__(
        self,
        record: Record,
        system: Actor | None = None,
        *,
        ensembles: Mapping[str, Ensemble] | None = None,
        predicates: PredicateManager | None = None,
        places: Places | None = None,
        title: str = "",
        summary: Summary | None = None,
    ) -> None:
        if record.span is None:
            raise Error(f"{record.path}: there are no messages to show")
        self._record = record
        self._title = title or record.path.name
        self._system = system
        self._models = {ensemble.path: ensemble for ensemble in (ensembles or {}).values()}
        self._manager = predicates
        self._places = places
        self._epoch, self._end = record.span
        self.first, self.last = 0.0, self._seconds(self._end)
        self.breaks = not record.grows and (record.torn is not None or record.closed is False)
        self._names = names_of(record)
        self._ensembles: dict[str, EnsembleReducer] = {}
        self._faults, self._poses, self._journeys = Track(), Track(), Track()
        self._spells: list[tuple[str, Told]] = []
        self._predicates: dict[str, Track] = {}
        self._beliefs: OrderedDict[tuple[str, int], Any] = OrderedDict()
        self._remarks: list[str] = []
        self._events: dict[bool, list[bytes]] = {}
        self.restored: str | None = None
        self.restorable = system is not None and predicates is not None
        self.pending, self.generation = False, 0
        self._judges = [self._judge(), self._judge()]  # of faults and agents; of predicates
        if summary is None:
            self._read()
        else:
            self._restore(summary)
        self._tell_damage()
        self._remarks += [self.restored] if self.restored else []

    @property
    def grows(self) -> bool:
        """Whether the record was still being written when it was read."""
        return self._record.grows

    def _seconds(self, time: int) -> float:
        return (time - self._epoch) / 1e9  # all digits: a step lands on what happened, and no microsecond before it

    def _time(self, seconds: float) -> int:
        return self._epoch + round(min(max(seconds, self.first), self.last) * 1e9)

    # -- What the reducers are fed with --------------------------------------------------------------------------

    def _read(self) -> None:
        record = self._record
        topics = [name for name in _TOPICS if name in record.topics]
        total = sum(record.counts[topic] for topic in topics)
        for count, (topic, _, _, data) in enumerate(record.raw(topics)):
            if not count % 4096:
                report_share(f"reading {record.path.name}", count / total)
            if topic == "stimuli" and not _TOLD.search(data):
                continue  # most are decoded for nothing
            message = record.decode(topic, data)
            if isinstance(message, Decision | ActionLife | Mode | Idle):
                self._reducer(message.ensemble).add(message)
            else:
                self._take(message)
        for name in record.metadata:
            if name.startswith("ensemble "):
                self._reducer(name.removeprefix("ensemble "))
        self._ensembles = dict(sorted(self._ensembles.items()))
        for ensemble in self._ensembles.values():
            ensemble.judge.finish(self._end)
        for judge in self._judges:
            judge.finish(self._end)
        self._spells.sort(key=lambda pair: pair[1].time)
        report_share(f"reading {record.path.name}", 1.0)

    # -- Its summary ---------------------------------------------------------------------------------------------

    def summary(self, *, within: bool = False) -> Summary:
        """Return the summary, of which another one of the same record is made without reading it.

        Args:
            within: Have one to be kept in the record itself, which has the checksum of no file.
        """
        own = {name: packed(getattr(self, name)) for name in _TRACKS}
        own |= {f"predicate {name}": packed(track) for name, track in self._predicates.items()}
        columns = {
            path: {name: packed(track) for name, track in each.tracks().items() if track.times}
            for path, each in self._ensembles.items()
        }
        facts = {
            "believes": [path for path, each in self._ensembles.items() if each.believes],
            "restored": self.restored,
            "told": self._spells,
            "spells": {path: each.judge.named for path, each in self._ensembles.items()},
            "run": [judge.named for judge in self._judges],
        }
        encoded = {name: msgspec.Raw(msgspec.msgpack.encode(fact)) for name, fact in facts.items()}
        return Summary(() if within else self._record.checksums, {"": own, **columns}, encoded)

    def _restore(self, summary: Summary) -> None:
        """Take all in from a summary.

        Raises:
            Error: If it lacks something.
        """
        try:
            for name, column in summary.columns.pop("").items():
                if name.startswith("predicate "):
                    track = self._predicates[name.removeprefix("predicate ")] = Track()
                    unpack(column, track, bool | None)
                else:
                    unpack(column, getattr(self, name), _TRACKS[name])
            believes, self.restored, self._spells, spells, run = [
                msgspec.msgpack.decode(summary.facts[name], type=kind) for name, kind in _FACTS.items()
            ]
            for judge, kept in zip(self._judges, run, strict=True):
                judge.named = kept
            for path, columns in summary.columns.items():
                each = self._reducer(path)
                each.believes = path in believes
                each.judge.named = spells[path]
                for name, column in columns.items():
                    unpack(column, *each.track(name))
        except (KeyError, AttributeError, ValueError, zlib.error, msgspec.MsgspecError) as error:
            raise Error(f"the summary lacks something: {error}") from None

    def _take(self, message: Any) -> None:
        """Take a message of no ensemble, or of one that has told something before."""
        if isinstance(message, Fault):
            self._faults.add(message.time, message)
            self._judges[0].fault(message)
            if message.kind == "waiting" and message.source in self._ensembles:
                self._ensembles[message.source].judge.fault(message)
        elif isinstance(message, Seen):
            self._judges[0].seen(message.time, message.agent, message.live)
        elif isinstance(message, Ticked):
            ticks = self._ensembles.get(message.actor.rpartition("/")[0])
            if message.missed and ticks is not None:
                ticks.judge.missed(message.time, message.missed)
        elif isinstance(message, Said) and isinstance(message.message, SensorUpdate):
            for name, value in message.message.predicates:
                self._judges[1].change(message.time, name, value)
        elif isinstance(message, Said) and isinstance(message.message, PoseUpdate | Journey):
            track = self._poses if isinstance(message.message, PoseUpdate) else self._journeys
            track.add(message.time, message.message)

    def _judge(self) -> RunJudge:
        found = RunJudge(lambda told: self._spells.append((told.of, told)))
        if self._manager is not None:
            found.held_for = self._manager.declared.held_for
        return found

    def _tell_damage(self) -> None:
        record = self._record
        if record.grows:
            self._remarks.append("the record is still being written: open it again for what has come since")
        elif record.torn is not None:
            self._remarks.append("the record ends before its run did")
        elif record.closed is False:
            self._remarks.append("the run's process ended before it closed the record")
        self._remarks += record.flaws
        if record.lost:
            self._remarks.append("from the first lost message on it may not be as it was")

    def _reducer(self, path: str) -> EnsembleReducer:
        found = self._ensembles.get(path)
        if found is None:
            found = self._ensembles[path] = EnsembleReducer(
                path, lambda *told: self._spells.append(told), self._known(path), epoch=self._epoch
            )
        return found

    def _known(self, path: str) -> Known:
        model = self._models.get(path)
        if model is not None:
            return known_of(model, controller=model.controller if is_as_recorded(self._record, model) else None)
        names = self._names.get(path, Names())
        space = Space.single("state", list(names.states)) if names.states else None
        return Known(space, lambda observation: names.observation(observation) or str(observation))

    # -- Lanes ---------------------------------------------------------------------------------------------------

    def lanes(
        self, first: float, last: float, paths: Sequence[str], predicates: Sequence[str], most: int = PARTS
    ) -> list[Event]:
        """Return the modes, lives and decisions of ensembles and the changes of predicates over some time, as events.

        Where there are more of a kind than are asked for, those of each part of the time stand together, as one event
        with their count: of changes that come to several values with the status ``several``, and of lives with the name
        and the status of the last one that failed, else of the last.

        Args:
            first: From this second on.
            last: To this second.
            paths: The ensembles.
            predicates: The predicates.
            most: Of each kind, of an ensemble or predicate.
        """
        begin, end = self._time(first), self._time(max(first, last))
        found: list[Event] = []
        for path in paths:
            if path in self._ensembles:
                found += self._ensembles[path].lane(begin, end, most)
        manager = "" if self._manager is None else self._manager.path
        for name in predicates:
            track = self._predicates.get(name, Track())
            for one, two in parts_of(track.times, begin, end, most):
                for place in dict.fromkeys((one, two - 1)):
                    event = predicate_event(self._seconds(track.times[place]), manager, name, track.entries[place])
                    if place == one < two - 1:
                        event = msgspec.structs.replace(event, status="several", count=two - one)
                    found.append(event)
        return found

    def _every_event(self, *, rare: bool) -> list[bytes]:
        """Return faults, judgements and times without anything to do, encoded, or these and all lanes."""
        found: list[Event] = []
        seconds, ensembles = self._seconds, self._ensembles
        if not rare:
            found += self.lanes(self.first, self.last, tuple(ensembles), tuple(self._predicates), _MOST)
        found += [event_of(each, seconds) for ensemble in ensembles.values() for each in ensemble.idles.entries]
        found += [event_of(fault, seconds) for fault in self._faults.entries[:_MOST]]
        found += [spell_event(path, told, seconds) for path, told in self._spells[:_MOST]]
        if len(self._faults.times) > _MOST:
            self.remark(f"the timeline has the first {_MOST:,} of {len(self._faults.times):,} faults")
        found.sort(key=lambda event: event.time)
        return [msgspec.json.encode(msgspec.structs.replace(each, number=n)) for n, each in enumerate(found, 1)]

    # -- What a replay restores ----------------------------------------------------------------------------------

    def restore(self, transports: Mapping[str, ReplayTransport] | None = None) -> None:
        """Restore the values of predicates by a replay; outside of an event loop, in some of the time of the run.

        Args:
            transports: Of a team's agent, those with which its member was built.
        """
        manager = self._manager
        if self._system is None or manager is None:
            return
        told, changes = replay_predicates(self._record, self._system, manager, transports or {})
        found = {name: Track() for name in manager.values()}
        self._spells = [(of, told) for of, told in self._spells if told.rule != "flickers"]
        self._judges[1] = judge = self._judge()
        for time, values in changes:
            for name, value in values.items():
                if not found[name].times or found[name].entries[-1] is not value:
                    found[name].add(time, value)
                judge.change(time, name, value)
        judge.finish(self._end)
        self._spells.sort(key=lambda pair: pair[1].time)
        self._predicates = {name: track for name, track in found.items() if track.times}
        self.restored = ""
        if not told.same:
            at = told.differences[0].recorded or told.differences[0].replayed
            until = "" if at is None else f" up to second {self._seconds(at.time):g}"
            self.restored = f"predicates are restored by a replay, which is the same as the run{until} alone"
            self.remark(self.restored)
        self._events.clear()

    def remark(self, text: str) -> None:
        """Add a remark on the run, once."""
        if text not in self._remarks:
            self._remarks.append(text)

    # -- The scene -----------------------------------------------------------------------------------------------

    def scene(self) -> Scene:
        """Return the scene."""
        head = self._record.head
        wall = int(head["wall"]) + self._epoch - int(head["epoch"]) if "wall" in head and "epoch" in head else 0
        declared = None if self._manager is None else self._manager.declared
        spaces = {path: each.judge.known.space for path, each in self._ensembles.items()}
        actions = {path: self._names[path].actions for path in self._ensembles if path in self._names}
        return Scene(
            version=__version__,
            source="record",
            title=self._title,
            began=wall if head.get("clock") == "wall" else 0,
            first=self.first,
            last=self.last,
            ensembles=ensembles_of({path: self._models.get(path) for path in self._ensembles}, spaces, actions),
            predicates=tuple(
                [
                    PredicateScene(name, "" if declared is None else declared.definition(name))
                    for name in self._predicates
                ]
            ),
            floors=() if self._places is None else floors_of(self._places),
            remarks=tuple(self._remarks),
            pending=self.pending,
            room={"fault": _MOST, "judgement": _MOST, "part": PARTS},
        )

    # -- Frames --------------------------------------------------------------------------------------------------

    def frame(self, seconds: float, close: Collection[str] = ()) -> Frame:
        """Return how everything was at a time.

        Args:
            seconds: The time, in seconds since the first message.
            close: The paths of ensembles that are looked at closely.
        """
        time = self._time(seconds)
        pose, journey = self._poses.at(time), self._journeys.at(time)
        goal = None if journey is None or journey.arrived else journey.place
        robot = None if self._places is None or pose is None else robot_at(self._places, pose, goal)
        near = [self._ensembles[path] for path in close if path in self._ensembles]
        values = [(track, track.place(time)) for track in self._predicates.values()]
        frames = tuple([each.frame(time) for each in self._ensembles.values()])
        judgements, headline = self._judged(time, stopped=all(each.mode == "stopped" for each in frames))
        return Frame(
            time=self._seconds(time),
            ensembles=frames,
            predicates=tuple([None if place < 0 else track.entries[place] for track, place in values]),
            changed=tuple([0.0 if place < 0 else self._seconds(track.times[place]) for track, place in values]),
            details={each.path: self._detail(each, time) for each in near},
            robots=() if robot is None else (robot,),
            statistics=StatisticsFrame({}, {}, {each.path: _ended(each, time) for each in near}),
            judgements=judgements,
            headline=headline,
        )

    @property
    def judgements(self) -> tuple[Judgement, ...]:
        """The judgements of the whole run, the worst first; those that are over with when that was."""
        return self._judged(self._end, stopped=True)[0]

    def _judged(self, time: int, *, stopped: bool) -> tuple[tuple[Judgement, ...], str]:
        judges = {path: each.judge for path, each in self._ensembles.items()}
        return judged(judges, self._judges, time, self._seconds, stopped=stopped)

    def _detail(self, each: EnsembleReducer, time: int) -> Detail:
        decided = each.decisions.at(time)
        return Detail() if decided is None else each.detail(time, self._belief(decided.message))

    def _belief(self, decision: Decision) -> Any:
        """Return the belief of a decision, read again from the record."""
        key = decision.ensemble, decision.time
        if key not in self._beliefs:
            self._beliefs[key] = self._read_belief(decision)
            if len(self._beliefs) > _BELIEFS:
                self._beliefs.popitem(last=False)
        return self._beliefs[key]

    def _read_belief(self, decision: Decision) -> Any:
        if not self._ensembles[decision.ensemble].believes:
            return None
        found = None
        for each in self._record.messages(["decisions"], decision.time, decision.time + 1):
            message = each.message
            if message.ensemble == decision.ensemble and message.epoch == decision.epoch:
                found = message.belief
        return found

    async def course(self, ensemble: str, first: float, last: float) -> Course | None:
        """Return how an ensemble's decisions went from a second to another one, read on a thread.

        Returns:
            None where there is no such ensemble.
        """
        if ensemble not in self._ensembles:
            return None
        return await asyncio.to_thread(self._course, ensemble, self._time(first), self._time(max(first, last)))

    def _course(self, path: str, first: int, last: int) -> Course:
        each = self._ensembles[path]
        known = each.judge.known

        def value(decision: Decision, current: Any) -> float | None:
            return expected_return(known.controller, current if decision.state is None else decision.state)

        places, count = sampled(each.decisions.times, first, last)
        told = [each.decisions.entries[place].message for place in places]
        return course_of(told, count, self._seconds, self._read_belief, value, known.state, known.space)

    # -- Events --------------------------------------------------------------------------------------------------

    def after(self, cursor: int, most: int, *, rare: bool = False) -> tuple[list[bytes], int]:
        """Return the first events behind a cursor, encoded, and the cursor behind them.

        Args:
            cursor: How many were had before.
            most: How many at most.
            rare: Leave out those of lanes, which `lanes` tells.
        """
        if rare not in self._events:
            self._events[rare] = self._every_event(rare=rare)
        events = self._events[rare]
        end = min(cursor + most, len(events))
        return events[cursor:end], end

    def step(self, kind: Step, seconds: float, *, back: bool = False) -> float:
        """Return the time of the next event of a kind, or of the one before; the same where there is none.

        A ``judgement`` is where one begins, a ``change`` is a decision for another action than that of the
        decision before it of the same ensemble.
        """
        time = self._time(seconds)
        times = {
            "decision": [each.decisions.times for each in self._ensembles.values()],
            "change": [each.changes.times for each in self._ensembles.values()],
            "mode": [each.modes.times for each in self._ensembles.values()],
            "fault": [self._faults.times],
            "judgement": [[told.time for _, told in self._spells if told.status == "begins"]],
        }.get(kind)
        if times is None:
            raise Error(f"there is no step to a {kind!r}; there are decision, change, fault, mode, judgement")
        found = []
        for each in times:
            place = bisect_left(each, time) - 1 if back else bisect_right(each, time)
            if 0 <= place < len(each):
                found.append(each[place])
        if not found:
            return self._seconds(time)
        return self._seconds(max(found) if back else min(found))

    async def explain(self, ensemble: str, seconds: float | None = None) -> Why | None:
        """Return why an ensemble decided as it did at a time; None where there is no such one."""
        if ensemble not in self._models:
            nothing = Why("Nothing tells why: the record holds no policy of this ensemble.")
            return nothing if ensemble in self._ensembles else None
        at = self.last if seconds is None else seconds
        return await asyncio.to_thread(why_recorded, self._record, self._models[ensemble], at)

    async def draw(self, path: str, seconds: float | None = None, opened: Collection[int] = ()) -> tuple[Picture, ...]:
        """Return pictures of an ensemble at a time, made on a thread; none where there is no such one."""
        if path not in self._ensembles:
            return ()
        at = self.last if seconds is None else seconds
        frames = zip(self._ensembles, self.frame(at).ensembles, strict=True)
        running = {each: [life.action for life in frame.live] or [frame.action] for each, frame in frames}
        return await asyncio.to_thread(self._draw, path, self._time(at), running, opened)

    def _draw(self, path: str, time: int, running: Any, opened: Collection[int]) -> tuple[Picture, ...]:
        track, model = self._ensembles[path].decisions, self._models.get(path)
        decisions = [each.message for each in track.entries[track.last(time, _WAY)]]
        case = None if model is None or not is_as_recorded(self._record, model) else case_of(model)
        way: list[Any] = []
        if model is not None and case is not None and decisions:
            if model.controller.takes != "state" and not model.controller.can_end:
                way = [self._read_belief(each) for each in decisions]
                case = case._replace(at=way[-1])
            elif decisions[-1].state is not None and getattr(case.policy, "table", None) is not None:
                case = case._replace(at=decisions[-1].state)
            else:
                every = [each.message for each in track.entries[: track.place(time) + 1]]
                with suppress(Error):  # one that the policy has not made has no way to light
                    case = case._replace(at=retraced(model.controller, every, len(every) - 1).at)
        way = [each for each in way[:-1] if each is not None]
        return pictures(case, self.scene().ensembles, path, running, opened=opened, way=way)


def _ended(each: EnsembleReducer, time: int) -> dict[str, int]:
    return {how: count for how, track in each.outcomes.items() if (count := track.place(time) + 1)}


def sampled(times: Sequence[int], first: int, last: int, most: int = POINTS) -> tuple[list[int], int]:
    """Return the places of the times that stand for all of some time, and how many there are in it.

    The last one before that time is one of them: it says how the time begins.

    Args:
        times: Of all decisions, in their order.
        first: The beginning of the time.
        last: Its end.
        most: How many places at most.
    """
    begin, end = bisect_left(times, first), bisect_right(times, last)
    before = [begin - 1] if begin else []
    if end - begin + len(before) <= most:
        return [*before, *range(begin, end)], end - begin
    parts = most - len(before)
    ends = [first + (last - first) * (part + 1) // parts for part in range(parts)]
    places = {bisect_right(times, each, begin, end) - 1 for each in ends}  # none of an empty part but that before it
    return [*before, *sorted(places - {begin - 1})], end - begin


def course_of(
    decisions: Iterable[Decision],
    count: int,
    seconds: Callable[[int], float],
    belief: Callable[[Decision], Any],
    value: Callable[[Decision, Any], float | None],
    name: Callable[[int], str],
    space: Space | None = None,
) -> Course:
    """Return how decisions went.

    Args:
        decisions: Those that are told.
        count: How many there were.
        seconds: Of a time in nanoseconds.
        belief: Reads the belief of a decision, None where there was none.
        value: The expected return from a decision on, made on that belief; None where it is not known.
        name: Of a state.
        space: The states, where their factors are known.
    """
    times, rewards, values, entropies = [], [], [], []
    factors: list[dict[str, float]] = []
    kept: list[dict[int, float] | None] = []
    sums: Counter[int] = Counter()
    for decision in decisions:
        current = belief(decision)
        times.append(seconds(decision.time))
        rewards.append(decision.reward)
        values.append(value(decision, current))
        found = chances_of(current)
        entropies.append(None if found is None else entropy(found[1]))
        factors.append({} if found is None else _shares(*found, space))
        chances = None if found is None else _likeliest(*found)
        kept.append(chances)
        sums.update(chances or {})
    states = [state for state, _ in sums.most_common(_STATES)]
    beliefs = [tuple([None if each is None else round(each.get(state, 0.0), 4) for each in kept]) for state in states]
    names = tuple([name(state) for state in states])
    told = dict.fromkeys(chain.from_iterable(factors))
    shares = tuple([(each, tuple([own.get(each) for own in factors])) for each in told])
    told_of_each = tuple(beliefs), tuple(rewards), tuple(values), tuple(entropies)
    return Course(tuple(times), count, names, *told_of_each, shares)


def _shares(states: Any, chances: Vector, space: Space | None) -> dict[str, float]:
    """Return the probabilities of the values of factors, by their names; none where there are many."""
    found = () if space is None or sum(space.shape) > _SYMBOLS else marginals(states, chances, space)[0]
    return {
        f"{each.factor} {symbol}": share
        for each in found
        for symbol, share in zip(each.symbols, each.values, strict=True)
    }


def _likeliest(states: Any, chances: Vector) -> dict[int, float]:
    """Return the likeliest states of a belief with their probabilities."""
    if len(chances) > _KEPT:
        most = np.argpartition(-chances, _KEPT)[:_KEPT]
        states, chances = states[most], chances[most]
    return dict(zip(states.tolist(), chances.tolist(), strict=True))
