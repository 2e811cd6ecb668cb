"""Snapshots of a recorded run at any time of it, in the shape of those of a running system.

The record is read through once; beliefs are read again where one is looked at. What a record does not keep, such as the
values of predicates, `restore` has from a replay, where the record has its configuration.
"""

from __future__ import annotations

import asyncio
from bisect import bisect_left, bisect_right
from collections import Counter, OrderedDict
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from mdm.errors import Error
from mdm.messages import (
    ActionLife,
    Decision,
    Fault,
    Idle,
    Journey,
    Mode,
    PoseUpdate,
    PredicateUpdate,
)
from mdm.models import Space
from mdm.recording.names import Names, names_of
from mdm.recording.stimuli import Said
from mdm.replay import replay
from mdm.snapshots.beliefs import belief_frame, grid_factors
from mdm.snapshots.causes import cause_in_words, changes, wired
from mdm.snapshots.course import Course, course_of, sampled
from mdm.snapshots.events import Event, value_of
from mdm.snapshots.floors import floors_of, robot_at
from mdm.snapshots.frame import CauseFrame, Detail, EnsembleFrame, Frame, LifeFrame, StatisticsFrame
from mdm.snapshots.live import expected_return, factors_of, remedy_of
from mdm.snapshots.observations import HISTORY, at_state, most_frequent, observed, on_observing
from mdm.snapshots.oddities import KEPT, SEEN, WINDOW, Ended, Seen, lasting, repeated, unmoved
from mdm.snapshots.scene import EnsembleScene, PredicateScene, Scene
from mdm.snapshots.spells import Spell, joined, spells
from mdm.snapshots.tracks import EnsembleTracks, Track
from mdm.snapshots.why import Why, is_as_recorded, why_recorded
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from mdm.actors import Ensemble, PredicateManager
    from mdm.maps import Places
    from mdm.recording.reader import Record
    from mdm.replay.transport import ReplayTransport
    from mdm.runtime import Actor, Runtime

__all__ = ["RecordedRun", "Step"]

Step = Literal["decision", "change", "fault", "mode", "odd"]

_TOPICS = ("stimuli", "decisions", "lives", "modes", "faults", "idles")
_MOST = 50_000
"""Events of a kind that are shown; of more decisions one stands for several."""
_BELIEFS = 64
"""Beliefs that are kept at hand."""


class RecordedRun:
    """A record, for those who look at it.

    Args:
        record: The record.
        system: The actors of the run, built from its configuration and not started, where there is one.
        title: What it is called.

    Raises:
        Error: If there is no message in it.

    Attributes:
        first: Its first second, which is 0.
        last: Its last one.
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
    ) -> None:
        if record.span is None:
            raise Error(f"{record.path}: there are no messages to show")
        self._record = record
        self._title = title or record.path.name
        self._system = system
        self._models = {ensemble.path: ensemble for ensemble in (ensembles or {}).values()}
        self._as_recorded = {path for path, model in self._models.items() if is_as_recorded(record, model)}
        self._manager = predicates
        self._places = places
        self._epoch, self._end = record.span
        self.first, self.last = 0.0, self._seconds(self._end)
        self._ensembles: dict[str, EnsembleTracks] = {}
        self._faults = Track()
        self._poses, self._journeys = Track(), Track()
        self._said: dict[type[Any], Track] = {PoseUpdate: self._poses, Journey: self._journeys}
        self._predicates: list[str] = []
        self._values = Track()
        self._beliefs: OrderedDict[tuple[str, int], Any] = OrderedDict()
        self._remarks: list[str] = []
        self._read()
        self._names = names_of(record)
        self._spaces = {path: self._space(path) for path in self._ensembles}
        self._wired = {path: wired(self._models.get(path)) for path in self._ensembles}
        self._spells = {path: self._spells_of(each) for path, each in self._ensembles.items()}
        self._tell_events()

    def _spells_of(self, each: EnsembleTracks) -> list[Spell]:
        """Return when something looked odd of an ensemble; a break as short as the time that is judged is none."""
        names = self._observer(each.path), self._namer(each.path)
        found = spells(each, self._end, self._composed(each.path), *names)
        return joined(found, round(WINDOW * 1e9))

    def _tell_events(self) -> None:
        self._encoded = [msgspec.json.encode(event) for event in self._made_events()]

    @property
    def grows(self) -> bool:
        """Whether the record was still being written when it was read."""
        return self._record.grows

    def _seconds(self, time: int) -> float:
        return (time - self._epoch) / 1e9  # all digits: a step lands on what happened, and no microsecond before it

    def _time(self, seconds: float) -> int:
        return self._epoch + round(min(max(seconds, self.first), self.last) * 1e9)

    # -- Reading -------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        for each in self._record.messages([name for name in _TOPICS if name in self._record.topics]):
            message = each.message
            if isinstance(message, Said):
                track = self._said.get(type(message.message))
                if track is not None:
                    track.add(message.time, message.message)
            elif isinstance(message, Fault):
                self._faults.add(message.time, message)
            elif isinstance(message, Decision | ActionLife | Mode | Idle):
                self._of(message.ensemble).add(message)
        record = self._record
        for name in record.metadata:
            if name.startswith("ensemble "):
                self._of(name.removeprefix("ensemble "))
        self._ensembles = dict(sorted(self._ensembles.items()))
        self._tell_damage()

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

    def _of(self, path: str) -> EnsembleTracks:
        found = self._ensembles.get(path)
        if found is None:
            found = self._ensembles[path] = EnsembleTracks(path)
        return found

    def _space(self, path: str) -> Space | None:
        if path in self._models:
            space: Space | None = self._models[path].controller.symbols.state_space
            return space
        names = self._names.get(path, Names()).states
        return Space.single("state", list(names)) if names else None

    def _observer(self, path: str) -> Callable[[object], str]:
        """Return what names an ensemble's observations."""
        return lambda symbol: self._observed(path, symbol) or ""

    def _namer(self, path: str) -> Callable[[int], str]:
        """Return what names an ensemble's states."""
        space = self._spaces[path]
        return str if space is None else space.names.__getitem__

    def _listed(self, path: str, what: str) -> list[str]:
        """Return the names of an ensemble's symbols, as the head of a record has them."""
        text = self._record.metadata.get(f"ensemble {path}", {}).get(what)
        try:
            return [] if text is None else msgspec.json.decode(text, type=list[str])
        except msgspec.MsgspecError:
            return []

    def _made_events(self) -> list[Event]:
        found: list[tuple[int, Any]] = []
        for ensemble in self._ensembles.values():
            decisions = ensemble.decisions
            step = -(-len(decisions.times) // _MOST) or 1
            pairs = list(zip(decisions.times, decisions.entries, strict=True))[::step]
            causes = [self._cause(ensemble, place) for place in range(0, len(decisions.times), step)]
            found += [(time, (decision, step, cause)) for (time, decision), cause in zip(pairs, causes, strict=True)]
            if step > 1:
                self.remark(f"{ensemble.path}: on the timeline one decision stands for {step:,}")
            found += zip(ensemble.modes.times, ensemble.modes.entries, strict=True)
            found += zip(ensemble.idles.times, ensemble.idles.entries, strict=True)
            for number, spell in enumerate(self._spells[ensemble.path][:_MOST], 1):
                found += [(time, (ensemble.path, number, spell)) for time in (spell.begin, spell.end)]
        found += zip(self._faults.times, self._faults.entries, strict=True)
        lives = [each.message for each in self._record.messages(["lives"])] if "lives" in self._record.topics else []
        begins = {(life.ensemble, life.life): life.time for life in lives if life.status == "running"}
        # The life of a plain function has no length, and its decision stands for it; a safe action has none.
        plain = {
            (life.ensemble, life.life)
            for life in lives
            if life.status == "succeeded"
            and life.action != "safe action"
            and begins.get((life.ensemble, life.life)) == life.time
        }
        lasting = [life for life in lives if (life.ensemble, life.life) not in plain]
        if len(lasting) > 2 * _MOST:
            self.remark(f"the timeline has the first {_MOST:,} of {len(lasting) // 2:,} actions")
        found += [(life.time, life) for life in lasting[: 2 * _MOST]]
        changes = self._changes()
        if len(changes) > _MOST:
            self.remark(f"the timeline has the first {_MOST:,} of {len(changes):,} changes of predicates")
        found += changes[:_MOST]
        found.sort(key=lambda pair: pair[0])
        return [self._event(number, time, each) for number, (time, each) in enumerate(found, 1)]

    def _changes(self) -> list[tuple[int, Any]]:
        """Return the changes of predicates with their times."""
        found: list[tuple[int, Any]] = []
        before: dict[str, bool | None] = {}
        for time, values in zip(self._values.times, self._values.entries, strict=True):
            found += [
                (time, (name, value))
                for name, value in values.items()
                if name in self._predicates and before.get(name) is not value
            ]
            before = values
        return found

    def _event(self, number: int, time: int, each: Any) -> Event:
        seconds = self._seconds(time)
        if isinstance(each, tuple) and isinstance(each[-1], Spell):
            path, spell_number, spell = each
            begins = time == spell.begin
            return Event(
                *(number, seconds, "odd", path, spell.rule, spell.text if begins else ""),
                status="odd" if begins else "over",
                life=spell_number,
            )
        if isinstance(each, tuple) and isinstance(each[0], str):
            assert self._manager is not None
            return Event(*(number, seconds, "predicate", self._manager.path, each[0]), status=value_of(each[1]))
        if isinstance(each, tuple):
            decision, count, cause = each
            return Event(
                *(number, seconds, "decision", decision.ensemble, decision.action_name),
                detail=cause,
                life=decision.epoch,
                at="" if decision.cause == "observation" else self._decided_at(decision),
                count=count,
            )
        if isinstance(each, ActionLife):
            return Event(*(number, seconds, "life", each.ensemble, each.action, each.detail, each.status, each.life))
        if isinstance(each, Mode):
            causes = "; ".join(f"{cause.kind}: {cause.detail}" for cause in each.causes)
            return Event(number, seconds, "mode", each.ensemble, each.mode, causes)
        if isinstance(each, Idle):
            status = "idle" if each.idle else "busy"
            return Event(number, seconds, "idle", each.ensemble, each.action, "intended" * each.intended, status)
        return Event(number, seconds, "fault", each.source, each.kind, each.detail, remedy=remedy_of(each.kind))

    # -- What a replay restores ----------------------------------------------------------------------------------

    def restore(self, transports: Mapping[str, ReplayTransport] | None = None) -> None:
        """Have the values of predicates from a replay; outside of an event loop, in some of the time of the run.

        Args:
            transports: Of a team's agent, those with which its member was built.
        """
        manager = self._manager
        if self._system is None or manager is None:
            return
        values: dict[str, bool | None] = {}

        def update(message: PredicateUpdate) -> None:
            values.update(dict.fromkeys(message.rising, True))
            values.update(dict.fromkeys(message.falling, False))
            values.update(dict.fromkeys(message.unknown, None))
            self._values.add(message.time, dict(values))

        def listen(runtime: Runtime) -> None:
            runtime.channel(f"{manager.path}/updates", PredicateUpdate).subscribe(update)

        told = replay(self._record, self._system, most=1, transports=transports or {}, listen=listen)
        if not told.same:
            at = told.differences[0].recorded or told.differences[0].replayed
            until = "" if at is None else f" up to second {self._seconds(at.time):g}"
            self._remarks.append(f"predicates are restored by a replay, which is the same as the run{until} alone")
        self._predicates = [name for name in manager.values() if name in values]
        self._tell_events()

    def remark(self, text: str) -> None:
        """Have something said of the run, once."""
        if text not in self._remarks:
            self._remarks.append(text)

    # -- The scene -----------------------------------------------------------------------------------------------

    def scene(self) -> Scene:
        """Return what there is."""
        head = self._record.head
        wall = int(head["wall"]) + self._epoch - int(head["epoch"]) if "wall" in head and "epoch" in head else 0
        declared = None if self._manager is None else self._manager.declared
        return Scene(
            version=__version__,
            source="record",
            title=self._title,
            began=wall if head.get("clock") == "wall" else 0,
            first=self.first,
            last=self.last,
            ensembles=tuple(self._ensemble_scenes()),
            predicates=tuple(
                [
                    PredicateScene(name, "" if declared is None else declared.definition(name))
                    for name in self._predicates
                ]
            ),
            floors=() if self._places is None else floors_of(self._places),
            remarks=tuple(self._remarks),
        )

    def _ensemble_scenes(self) -> Iterable[EnsembleScene]:
        paths = list(self._ensembles)
        for path in paths:
            above = path.rpartition("/")[0]
            model, space = self._models.get(path), self._spaces[path]
            actions = tuple(model.action.names) if model is not None else tuple(self._listed(path, "actions"))
            yield EnsembleScene(
                path=path,
                parent=paths.index(above) if above in self._ensembles else -1,
                bound=self._bound(above, path),
                summary="" if model is None else model.summary(),
                actions=actions[:64],
                states=0 if space is None else len(space),
                factors=factors_of(space, model),
                grid=grid_factors(space) is not None,
            )

    def _bound(self, above: str, path: str) -> str:
        if above not in self._models or path not in self._models:
            return ""
        action = self._models[above].action
        bindings = zip(action.names, action.bindings, strict=True)
        return next((name for name, each in bindings if each.ensemble is self._models[path]), "")

    # -- Frames --------------------------------------------------------------------------------------------------

    def frame(self, seconds: float, close: Collection[str] = ()) -> Frame:
        """Return how everything was at a time.

        Args:
            seconds: The time, in seconds since the first message.
            close: The paths of ensembles that are looked at closely.
        """
        time = self._time(seconds)
        values = self._values.at(time) or {}
        pose, journey = self._poses.at(time), self._journeys.at(time)
        goal = None if journey is None or journey.arrived else journey.place
        robot = None if self._places is None or pose is None else robot_at(self._places, pose, goal)
        return Frame(
            time=self._seconds(time),
            ensembles=tuple([self._ensemble_frame(each, time) for each in self._ensembles.values()]),
            predicates=tuple([values.get(name) for name in self._predicates]),
            changed=self._changed(time),
            details={path: self._detail(self._ensembles[path], time) for path in close if path in self._ensembles},
            robots=() if robot is None else (robot,),
            statistics=StatisticsFrame(
                {}, {}, {path: self._ended(path, time) for path in close if path in self._ensembles}
            ),
        )

    def _changed(self, time: int) -> tuple[float, ...]:
        """Return when each predicate last changed."""
        place = self._values.place(time)
        found: dict[str, float] = {}
        now = self._values.entries[place] if place >= 0 else {}
        while place >= 0 and len(found) < len(self._predicates):
            before = self._values.entries[place - 1] if place else {}
            for name in self._predicates:
                if name not in found and (place == 0 or before.get(name) is not now.get(name)):
                    found[name] = self._seconds(self._values.times[place])
            place -= 1
        return tuple([found.get(name, 0.0) for name in self._predicates])

    def _ended(self, path: str, time: int) -> dict[str, int]:
        ends = self._ensembles[path].ends
        return dict(Counter(end.status for end in ends.entries[: ends.place(time) + 1]))

    def _ensemble_frame(self, each: EnsembleTracks, time: int) -> EnsembleFrame:
        mode: Mode | None = each.modes.at(time)
        idle: Idle | None = each.idles.at(time)
        place = each.decisions.place(time)
        decision: Decision | None = each.decisions.entries[place] if place >= 0 else None
        causes = () if mode is None else mode.causes
        return EnsembleFrame(
            mode="stopped" if mode is None else mode.mode,
            since=0.0 if mode is None else self._seconds(mode.since),
            causes=tuple([CauseFrame(c.kind, c.detail, self._seconds(c.since), remedy_of(c.kind)) for c in causes]),
            idle=self._seconds(idle.since) if idle is not None and idle.idle else None,
            live=tuple([LifeFrame(life.action, self._seconds(life.time)) for life in each.lives.at(time) or ()]),
            epoch=-1 if decision is None else decision.epoch,
            action="" if decision is None else decision.action_name,
            decisions=place + 1,
            odd=() if mode is None or mode.mode != "deciding" else self._odd(each, time),
        )

    def _odd(self, each: EnsembleTracks, time: int) -> tuple[str, ...]:
        """Return what looks odd at a time, in words."""
        decision: Decision | None = each.decisions.at(time)
        found = []
        if decision is not None:
            first = each.repeats.place(time - round(WINDOW * 1e9)) + 1
            window = each.repeats.entries[first : each.repeats.place(time) + 1]
            found.append(repeated(decision.action_name, window.count(decision.action_name)))
        ended = each.ends.entries[each.ends.last(time, KEPT)]
        composed = self._composed(each.path)
        lives = [life for life in each.lives.at(time) or () if life.action not in composed]
        found += [lasting(life.action, (time - life.time) / 1e9, ended) for life in lives]
        last = each.seen.last(time, SEEN)
        if each.seen.times[last] and time - each.seen.times[last][-1] < WINDOW * 1e9:
            pairs = zip(each.seen.times[last], each.seen.entries[last], strict=True)
            seen = [Seen(self._seconds(at), *entry) for at, entry in pairs]
            found.append(unmoved(seen, self._observer(each.path), self._namer(each.path)))
        return tuple([text for text in found if text])

    def _composed(self, path: str) -> frozenset[str]:
        """Return the actions of an ensemble that are ensembles: these last as long as they are chosen."""
        if path not in self._models:
            return frozenset()
        action = self._models[path].action
        pairs = zip(action.names, action.bindings, strict=True)
        return frozenset([name for name, binding in pairs if binding.ensemble is not None])

    def _history(self, each: EnsembleTracks, time: int) -> tuple[tuple[float, str], ...]:
        """Return the last observations by a time, by name."""
        last = each.observed.last(time, HISTORY)
        pairs = zip(each.observed.times[last], each.observed.entries[last], strict=True)
        return tuple([(self._seconds(at), self._observed(each.path, symbol) or "") for at, symbol in pairs])

    def _tally(self, each: EnsembleTracks, time: int) -> tuple[tuple[str, int], ...]:
        """Return how often each observation came by a time."""
        counts: Counter[str] = Counter()
        for symbol, times in each.observations.items():
            if count := bisect_right(times, time):
                counts[self._observed(each.path, symbol) or ""] += count
        return most_frequent(counts)

    def _detail(self, each: EnsembleTracks, time: int) -> Detail:
        decision: Decision | None = each.decisions.at(time)
        if decision is None:
            return Detail()
        space = self._spaces[each.path]
        current = self._belief(each.path, decision)
        factors: tuple[tuple[str, str | None], ...] = ()
        state = None
        if decision.state is not None:
            state = str(decision.state) if space is None else space.names[decision.state]
            if space is not None and len(space.factors) > 1:
                parts = zip(space.factors, space.unravel(decision.state), strict=True)
                factors = tuple([(factor.name, factor.names[value]) for factor, value in parts])
        return Detail(
            state=state,
            factors=factors,
            observation=self._observed(each.path, decision.observation),
            cause=self._cause(each, each.decisions.place(time)),
            decided=self._seconds(decision.time),
            reward=decision.reward,
            value=self._return(decision, current),
            belief=belief_frame(current, space),
            observations=self._history(each, time),
            tally=self._tally(each, time),
        )

    def _observed(self, path: str, observation: Any) -> str | None:
        if observation is None:
            return None
        if path in self._models:
            return observed(self._models[path].controller.symbols.observation_space, observation)
        found = self._names.get(path, Names()).observation(observation)
        return found or str(observation)

    def _cause(self, each: EnsembleTracks, place: int) -> str:
        """Return the cause of a decision by its place, in words."""
        decision: Decision = each.decisions.entries[place]
        before: Decision | None = each.decisions.entries[place - 1] if place > 0 else None
        ended: Ended | None = each.ends.at(decision.time) if decision.cause == "again" else None
        return cause_in_words(
            decision.cause,
            observed=self._observed(each.path, decision.observation) or "",
            changed=changes(self._wired[each.path], None if before is None else before.state, decision.state),
            ended=None if ended is None or before is None or ended.action != before.action_name else ended,
        )

    def _decided_at(self, decision: Decision) -> str:
        """Return the state or observation of a decision, by name."""
        if decision.state is None:
            return on_observing(self._observed(decision.ensemble, decision.observation))
        return at_state(self._spaces[decision.ensemble], decision.state)

    def _belief(self, path: str, decision: Decision) -> Any:
        """Return the belief of a decision, which the record is asked for anew."""
        key = path, decision.time
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

    def _return(self, decision: Decision, current: Any) -> float | None:
        """Return the expected return from a decision on; None where its policy is not known, or does not tell it."""
        if decision.ensemble not in self._as_recorded:
            return None
        controller = self._models[decision.ensemble].controller
        return expected_return(controller, decision.state if controller.takes == "state" else current)

    async def course(self, ensemble: str, first: float, last: float) -> Course | None:
        """Return how an ensemble's decisions went from a second to another one, read on a thread.

        Returns:
            None where there is no such ensemble.
        """
        if ensemble not in self._ensembles:
            return None
        return await asyncio.to_thread(self._course, ensemble, self._time(first), self._time(max(first, last)))

    def _course(self, path: str, first: int, last: int) -> Course:
        decisions = self._ensembles[path].decisions
        places, count = sampled(decisions.times, first, last)
        told = [decisions.entries[place] for place in places]
        return course_of(told, count, self._seconds, self._read_belief, self._return, self._namer(path))

    # -- Events --------------------------------------------------------------------------------------------------

    def after(self, cursor: int, most: int) -> tuple[list[bytes], int]:
        """Return the first events behind a cursor, encoded, and the cursor behind them."""
        end = min(cursor + most, len(self._encoded))
        return self._encoded[cursor:end], end

    def step(self, kind: Step, seconds: float, *, back: bool = False) -> float:
        """Return the time of the next event of a kind, or of the one before; the same where there is none.

        An ``odd`` is where something begins to look odd, a ``change`` is a decision for another action than that of the
        decision before it of the same ensemble.
        """
        time = self._time(seconds)
        times = {
            "decision": [each.decisions.times for each in self._ensembles.values()],
            "change": [each.changes.times for each in self._ensembles.values()],
            "mode": [each.modes.times for each in self._ensembles.values()],
            "fault": [self._faults.times],
            "odd": [[spell.begin for spell in found] for found in self._spells.values()],
        }.get(kind)
        if times is None:
            raise Error(f"there is no step to a {kind}: decision, change, fault, mode, odd")
        found = []
        for each in times:
            place = bisect_left(each, time) - 1 if back else bisect_right(each, time)
            if 0 <= place < len(each):
                found.append(each[place])
        if not found:
            return self._seconds(time)
        return self._seconds(max(found) if back else min(found))

    async def explain(self, ensemble: str, seconds: float | None = None) -> Why | None:
        """Return why an ensemble decided as it did at a time; None where its configuration is not known."""
        if ensemble not in self._models:
            return None
        at = self.last if seconds is None else seconds
        return await asyncio.to_thread(why_recorded, self._record, self._models[ensemble], at)
