"""A running system as a source of snapshots: it feeds the reducers, and asks the actors what no message tells.

No decision is heard, which would cost each of them: between turns decisions are counted, and the last one is read.
Modes, faults, idleness and actions that last are rare, and each of them is heard.
"""

from __future__ import annotations

import asyncio
import time as times
from bisect import bisect_left
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.actors import Ensemble, PredicateManager
from mdm.errors import Error
from mdm.maps.places import Places
from mdm.messages import Action, ActionLife, Decision, Idle, Mode, Observation, PredicateUpdate, Progress, Reward, State
from mdm.runtime.actor import descendants
from mdm.runtime.observing import Observer
from mdm.snapshots.events import ROOM, Ring, event_of, predicate_event, spell_event
from mdm.snapshots.frame import Detail, EnsembleFrame, Frame, LifeFrame, PredicateScene, Scene, Spread, StatisticsFrame
from mdm.snapshots.judgement import RunJudge, judged
from mdm.snapshots.picture import Picture, case_of, pictures
from mdm.snapshots.reducer import EnsembleReducer, known_of
from mdm.snapshots.scenes import ensembles_of, floors_of, robot_frame
from mdm.snapshots.why import Why, why
from mdm.snapshots.words import valued
from mdm.team import Member
from mdm.team.transport.keys import owner_of
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Collection

    from mdm.messages import Fault
    from mdm.runtime import Histogram, Runtime
    from mdm.runtime.observing import Guard
    from mdm.snapshots.judgement import Told

_SECOND = 1_000_000_000
_encode = msgspec.json.Encoder().encode
_UNSEEN: Any = object()
"""In place of the value of a predicate that has not been looked at, and may be unknown."""
_ALL = 50
"""Ensembles up to which each frame looks at all: to look at one costs ten microseconds, and a thousand have turns."""
_TURNS = 20
"""Ensembles that have their turn in a frame, changed or not; a quarter of all where a second has passed."""
_CHANGED = 100
"""Ensembles that have changed and are looked at in a frame: of more, the others are in the next ones.

Those whose mode has changed are looked at besides. So a frame keeps decisions waiting for some milliseconds, and comes
several times a second, where a thousand ensembles decide all the time.
"""


class _Ensemble:
    """Feeds the reducer of an ensemble, and keeps its last frame for as long as nothing changes."""

    def __init__(self, ensemble: Ensemble, reducer: EnsembleReducer) -> None:
        controller = ensemble.controller
        self.ensemble = ensemble
        self.reducer = reducer
        self.path = ensemble.path
        self.stale = True
        self.urgent = False
        self.actions = ensemble.channel("action", Action)
        self._rewards = ensemble.channel("reward", Reward, retain=True)
        # The first picture tells those so far, by the last of them; that of one that has come back, those since then.
        known = reducer.decisions.entries
        self.decisions = known[-1].total if known else 0
        self.detail: tuple[tuple[Any, ...], Detail] | None = None
        self.encoded = msgspec.Raw(b"")
        status = ensemble.status()
        self._repeats = status.repeats if known else 0
        self._missed = status.missed
        self._searches = status.searches
        self._waiting: tuple[str, ...] | None = None
        self._key: tuple[Any, ...] = ()
        self._frame: EnsembleFrame | None = None
        reducer.judge.known = known_of(ensemble, controller=controller)

    def decision(self) -> bool:
        """Take the last decision, if it is a new one; return whether it is."""
        ensemble = self.ensemble
        last: Any = self.actions.last  # none where the ensemble has ended, and begun once more
        decisions = self.actions.published
        if last is None or self.decisions == decisions:
            return False
        controller, status = ensemble.controller, ensemble.status()
        cause, repeats, self._waiting = status.cause, status.repeats, status.waiting
        reward: Any = self._rewards.last
        foreign = cause == "team"
        observation = None if foreign or controller.takes == "state" else self._taken_in(cause)
        decision = Decision(
            last.time,
            self.path,
            last.epoch,
            cause,
            state=None if foreign else last.state,
            observation=observation,
            belief=None if observation is None else controller.decided_by,
            action=last.index,
            action_name=ensemble.joint_name(last.index),
            wanted=last.wanted,
            wanted_name=None if last.wanted is None else ensemble.joint_name(last.wanted),
            reward=None if reward is None or reward.epoch != last.epoch else reward.value,
        )
        self.reducer.add(decision, decisions - self.decisions, repeats - self._repeats)
        self.decisions, self._repeats = decisions, repeats
        if status.missed > self._missed:
            self.reducer.judge.missed(last.time, status.missed - self._missed)
        self._missed = status.missed
        return True

    def _taken_in(self, cause: str) -> Any:
        """Return the observation that the last decision took in, by index or components; None where it took in none."""
        observation = self.ensemble.controller.observed
        seen: Any = self.ensemble.channel("observation", Observation).last
        if isinstance(observation, frozenset):  # those that agree with its components
            return tuple(seen.values)
        if observation is None and cause == "observation" and seen is not None:  # which has begun an episode
            return tuple(seen.values) if seen.index is None else seen.index
        return observation

    def missed(self, now: int, *, lost: bool) -> list[Mode | Idle | ActionLife]:
        """Return messages in the place of those that nobody heard: before the first look, or lost ones."""
        ensemble, reducer = self.ensemble, self.reducer
        status = ensemble.status()
        since = status.idle_since
        found: list[Mode | Idle | ActionLife] = []
        mode = reducer.modes.at(now)
        known = ("stopped", ()) if mode is None else (mode.mode, mode.causes)
        if (lost or mode is None) and known != (status.mode, status.causes):
            time = status.since if mode is None else now
            found.append(Mode(time, self.path, status.mode, status.since, status.causes))
        idle = reducer.idles.at(now)
        if (idle is not None and idle.idle) != (since is not None):
            time = since if since is not None and idle is None else now
            found.append(Idle(time, self.path, since is not None, since or now, "", intended=False))
        lives = ensemble.action.lives
        living = {life.number: life for life in lives.living if life not in lives.replaced}
        told = reducer.judge.living.keys()
        for number in told - living.keys():
            reducer.lose(number, now)
        for number in living.keys() - told:
            life = living[number]
            time = life.action.time if reducer.heard is None else now
            found.append(ActionLife(time, self.path, number, life.name, "running"))
        if lost or mode is None:
            reducer.heard = now
        return sorted(found, key=lambda message: message.time)

    def frame(self, now: int) -> EnsembleFrame:
        """Return how the ensemble is."""
        self.stale = self.urgent = False
        reducer = self.reducer
        waiting = self.ensemble.waiting if self._waiting is None else self._waiting
        self._waiting = None
        reducer.judge.settle(now + 1)
        key = (reducer.version, waiting)
        if self._frame is None or key != self._key:
            self._key = key
            self._frame = reducer.frame(now, waiting)
            self.encoded = msgspec.Raw(_encode(self._frame))
        return self._frame

    def look_closely(self, now: int) -> Detail:
        """Return the ensemble at close range; the same for as long as nothing changes."""
        ensemble, controller = self.ensemble, self.ensemble.controller
        state: Any = ensemble.channel("state", State, retain=True).last
        current = controller.decided_by if controller.takes != "state" else None
        key = (self.reducer.version, state, current)
        before = self.detail
        if before is None or key[0] != before[0][0] or state is not before[0][1] or current is not before[0][2]:
            space = controller.symbols.state_space
            factors: tuple[tuple[str, str | None], ...] = ()
            if space is not None and state is not None and len(state.values) == len(space.factors):
                factors = valued(space, state.values)
            search = _searched(ensemble.layer_statistics()["planner"]) if self._searches else ""
            self.detail = before = key, self.reducer.detail(now, current, factors=factors, search=search)
        return before[1]


class LiveRun(Observer):
    """A running system, for those who look at it.

    Args:
        runtime: The runtime, which runs.
        title: Its title.
        control: Whether commands are taken.

    Attributes:
        ring: Its events.
        generation: Counts the scenes: it grows when ensembles, predicates or floors come or go.
    """

    name = "the page"

    def __init__(self, runtime: Runtime, *, title: str = "", control: bool = False) -> None:
        self._runtime = runtime
        self._guard: Guard | None = None
        self._title = title
        self._control = control
        self._epoch = runtime.now()
        self._began = times.time_ns()
        self._seen = -1
        self._lost = 0
        self._reducers: dict[str, EnsembleReducer] = {}
        self._by_path: dict[str, _Ensemble] = {}
        self._ensembles: list[_Ensemble] = []
        self._place_of: dict[str, int] = {}
        self._frames: list[EnsembleFrame] = []
        self._turn = self._next = 0
        self._turned = self._epoch
        self._managers: list[PredicateManager] = []
        self._owners: list[tuple[PredicateManager, str]] = []
        self._values: tuple[Any, ...] = ()
        self._glanced = self._epoch
        self._heard: dict[str, int] = {}
        self._changed: list[float] = []
        self._places: list[Places] = []
        self._members: list[Member] = []
        self._counted = -_SECOND
        self._statistics: StatisticsFrame | None = None
        self._summed: tuple[int, int] | None = None
        self._team: dict[str, dict[str, str]] = {}
        self._scene: Scene | None = None
        self._run = RunJudge(lambda told: self._on_judged(told.of, told), whole=False)
        self.ring = Ring()
        self.generation = 0

    def open(self) -> None:
        """Hear modes, faults, idleness and actions that last."""
        self._guard = self._runtime.observe(self)

    def close(self) -> None:
        """Hear nothing more."""
        if self._guard is not None:
            self._guard.cancel()

    @property
    def _lost_now(self) -> int:
        return 0 if self._guard is None else self._guard.lost

    def _seconds(self, time: int) -> float:
        return (time - self._epoch) / 1e9

    @property
    def now(self) -> float:
        """Seconds since the run's second 0."""
        return self._seconds(self._runtime.now())

    # -- What the reducers are fed with --------------------------------------------------------------------------

    def _reducer(self, path: str) -> EnsembleReducer:
        found = self._reducers.get(path)
        if found is None:
            found = self._reducers[path] = EnsembleReducer(path, self._on_judged, whole=False, epoch=self._epoch)
        return found

    def _take(self, message: Mode | Idle | ActionLife, *, urgent: bool) -> None:
        self.ring.keep(event_of(message, self._seconds))
        self._reducer(message.ensemble).add(message)
        if (found := self._by_path.get(message.ensemble)) is not None:
            found.stale = True
            found.urgent = found.urgent or urgent

    def on_mode(self, mode: Mode) -> None:
        """Show another mode of an ensemble."""
        self._take(mode, urgent=True)

    def on_idle(self, idle: Idle) -> None:
        """Show that an ensemble is idle, or no longer."""
        self._take(idle, urgent=True)

    def on_life(self, life: ActionLife) -> None:
        """Show that an action has begun or ended."""
        self._take(life, urgent=False)

    def on_fault(self, fault: Fault) -> None:
        """Show a fault."""
        self.ring.keep(event_of(fault, self._seconds))
        self._run.fault(fault)
        if fault.kind == "waiting" and fault.source in self._by_path:
            self._reducer(fault.source).judge.fault(fault)

    def _on_judged(self, path: str, told: Told) -> None:
        self.ring.keep(spell_event(path, told, self._seconds))

    def _catch_up(self, ensembles: list[_Ensemble], now: int, *, lost: bool) -> None:
        for each in ensembles:
            for message in each.missed(now, lost=lost):
                self._take(message, urgent=True)

    # -- The scene -----------------------------------------------------------------------------------------------

    def scene(self) -> Scene:
        """Return the scene; another one where actors have come or gone."""
        self._look_around()
        assert self._scene is not None
        return self._scene

    def _look_around(self) -> None:
        runtime = self._runtime
        if self._seen == runtime.lives.published and self._scene is not None:
            return
        self._seen = runtime.lives.published
        actors = [actor for actor in descendants(runtime.root) if actor.life in {"running", "restarting", "stopping"}]
        ensembles = [actor for actor in actors if isinstance(actor, Ensemble)]
        if [each.ensemble for each in self._ensembles] != ensembles:
            now = runtime.now()
            met = {id(each.ensemble): each for each in self._ensembles}
            self._ensembles = [met.get(id(each)) or _Ensemble(each, self._reducer(each.path)) for each in ensembles]
            self._by_path = {each.path: each for each in self._ensembles}
            self._place_of = {each.path: place for place, each in enumerate(self._ensembles)}
            self._catch_up([each for each in self._ensembles if id(each.ensemble) not in met], now, lost=False)
            self._frames = [each.frame(now) for each in self._ensembles]
        self._managers = [actor for actor in actors if isinstance(actor, PredicateManager)]
        self._places = [actor for actor in actors if isinstance(actor, Places)]
        self._members = [actor for actor in actors if isinstance(actor, Member)]
        known = dict(zip(self._owners, zip(self._values, self._changed, strict=True), strict=True))
        self._owners = [(manager, name) for manager in self._managers for name in manager.values()]
        found = [known.get(owner, (_UNSEEN, self.now)) for owner in self._owners]
        self._values = tuple([value for value, _ in found])
        self._changed = [changed for _, changed in found]
        scene = self._made_scene()
        self._run.held_for = {
            shown.name: manager.declared.held_for.get(name, 0)
            for shown, (manager, name) in zip(scene.predicates, self._owners, strict=True)
        }
        if scene != self._scene:
            self._scene = scene
            self.generation += 1
            self._counted = -_SECOND  # who has just come, such as a team, is counted with the next frame

    def _made_scene(self) -> Scene:
        several = len(self._managers) > 1
        predicates = [
            PredicateScene(
                f"{manager.path}/{name}" if several else name,
                manager.declared.definition(name),
                name in manager.settable,
            )
            for manager, name in self._owners
        ]
        ensembles = {each.path: each.ensemble for each in self._ensembles}
        spaces = {path: ensemble.controller.symbols.state_space for path, ensemble in ensembles.items()}
        return Scene(
            version=__version__,
            source="live",
            title=self._title,
            began=self._began,
            first=0.0,
            last=0.0,
            ensembles=ensembles_of(ensembles, spaces, {}),
            predicates=tuple(predicates),
            floors=tuple([floor for places in self._places for floor in floors_of(places)]),
            control=self._control,
            room=ROOM,
        )

    # -- Frames --------------------------------------------------------------------------------------------------

    def frame(self, close: Collection[str] = ()) -> Frame:
        """Return how everything is.

        Args:
            close: The paths of ensembles that are looked at closely.
        """
        self._look_around()
        now = self._runtime.now()
        if self._lost != self._lost_now:
            self._lost = self._lost_now
            self._catch_up(self._ensembles, now, lost=True)
        for place in self._due(now, close):
            each = self._ensembles[place]
            if each.decision():
                place_of = len(each.reducer.decisions.times) - 1
                self.ring.keep(each.reducer.decision_event(place_of))
            self._frames[place] = each.frame(now)
        self.glance()
        if now - self._counted >= _SECOND:
            self._counted = now
            self._statistics = self._count(close)
            self._team = {} if not self._members else _teams(self._members)
            for member in self._members:
                self._run.seen(now, member.agent, member.statistics().live)
        self._run.settle(now + 1)
        judges = {each.path: each.reducer.judge for each in self._ensembles}
        stopped = all(each.mode == "stopped" for each in self._frames)
        judgements, headline = judged(judges, [self._run], now, self._seconds, stopped=stopped)
        near = [self._by_path[path] for path in close if path in self._by_path]
        robots = [robot_frame(places, places.pose, places.heading_for) for places in self._places]
        return Frame(
            time=self._seconds(now),
            ensembles=tuple(self._with_progress(self._frames)),
            predicates=self._values,
            changed=tuple(self._changed),
            details={each.path: each.look_closely(now) for each in near},
            robots=tuple([robot for robot in robots if robot is not None]),
            statistics=self._statistics,
            team=self._team,
            judgements=judgements,
            headline=headline,
        )

    def encoded(self, close: Collection[str] = ()) -> bytes:
        """Return how everything is, as JSON; an unchanged ensemble is not encoded again.

        Args:
            close: The paths of ensembles that are looked at closely.
        """
        frame = self.frame(close)
        pairs = zip(frame.ensembles, self._frames, self._ensembles, strict=True)
        kept: Any = tuple([of.encoded if one is two else msgspec.Raw(_encode(one)) for one, two, of in pairs])
        return _encode(msgspec.structs.replace(frame, ensembles=kept))

    def _due(self, now: int, close: Collection[str]) -> Collection[int]:
        """Return the places of the ensembles to look at: changed, close, or due for their turn; of few, all."""
        ensembles = self._ensembles
        size = len(ensembles)
        if size <= _ALL:
            return range(size)
        count = _TURNS if now - self._turned < _SECOND else max(_TURNS, size // 4)
        first, self._turn, self._turned = self._turn, (self._turn + count) % size, now
        due = {(first + place) % size for place in range(count)}
        due.update([self._place_of[path] for path in close if path in self._place_of])
        # Hot path: the loop over all of a thousand ensembles, in a tenth of a millisecond.
        changed = [
            place for place, each in enumerate(ensembles) if each.stale or each.decisions != each.actions.published
        ]
        if len(changed) > _CHANGED:
            due.update([place for place in changed if ensembles[place].urgent])
            start = bisect_left(changed, self._next)
            changed = (changed[start:] + changed[:start])[:_CHANGED]
            self._next = changed[-1] + 1
        due.update(changed)
        return sorted(due)

    def _tell_pulses(self, since: int, now: int) -> None:
        """Mark predicates that changed and came back between two looks, with the number of updates that came."""
        scene = self._scene
        for manager in self._managers:
            published, last = manager.updates.published, manager.updates.last
            missed = published - self._heard.get(manager.path, published)
            self._heard[manager.path] = published
            if missed < 2 or not isinstance(last, PredicateUpdate) or scene is None:
                continue
            names, values = {*last.rising, *last.falling, *last.unknown}, manager.values()
            for (owner, name), before, shown in zip(self._owners, self._values, scene.predicates, strict=True):
                if owner is manager and name in names and values[name] is before:
                    event = predicate_event(self._seconds(since), manager.path, shown.name, before)
                    self.ring.keep(msgspec.structs.replace(event, status="several", count=missed))
                    self.ring.keep(predicate_event(self._seconds(now), manager.path, shown.name, before))

    def glance(self) -> None:
        """Look at predicates alone, more often than frames are made where nobody looks."""
        now = self._runtime.now()
        self._tell_pulses(self._glanced, now)
        self._glanced = now
        known = {id(manager): manager.values() for manager in self._managers}
        values = tuple([known[id(manager)].get(name) for manager, name in self._owners])
        if values == self._values:
            return
        assert self._scene is not None
        seconds = self._seconds(now)
        for place, (value, before) in enumerate(zip(values, self._values, strict=True)):
            if value is not before:
                self._changed[place] = seconds
                name = self._scene.predicates[place].name
                self.ring.keep(predicate_event(seconds, self._owners[place][0].path, name, value))
                self._run.change(now, name, value)
        self._values = values

    def _with_progress(self, frames: list[EnsembleFrame]) -> list[EnsembleFrame]:
        """Say how far a drive is, where one alone is under way that tells it."""
        if len(self._places) != 1 or self._places[0].heading_for is None:
            return frames
        goal = self._places[0].heading_for
        told: list[Any] = [each.last for each in self._runtime.channels if each.type is Progress and each.last]
        drives = [each for each in told if each.place == goal]
        if len(drives) != 1:
            return frames
        remaining = round(drives[0].remaining, 2)
        leaf = [place for place, frame in enumerate(frames) if frame.live]
        if leaf:
            frames = [*frames]
            frame = frames[leaf[-1]]
            lives = (*frame.live[:-1], LifeFrame(frame.live[-1].action, frame.live[-1].since, remaining))
            frames[leaf[-1]] = msgspec.structs.replace(frame, live=lives)
        return frames

    def _count(self, close: Collection[str]) -> StatisticsFrame:
        runtime = self._runtime
        told = runtime.dispatcher.statistics()
        counts: dict[str, float] = {
            "inputs handled": told.turns,
            "inputs that took long and let others go first": told.interrupted,
            "messages of threads": told.from_threads,
            "replaced by newer ones": told.replaced,
            "lost": told.lost,
            "refused": told.refused,
            "dropped on streams": self._dropped_on_streams(),
        }
        if runtime.recorder is not None:
            counts["lost of the record"] = runtime.recorder.statistics().dropped
        counts["lost of the page"] = self._lost_now
        near = [self._by_path[path] for path in close if path in self._by_path]
        for each in near:
            statistics = each.ensemble.layer_statistics()["control"]
            for name in ("superseded", "undecided", "missed", "impossible"):
                if value := getattr(statistics, name):
                    counts[f"{each.path}: {name}"] = value
        return StatisticsFrame(
            counts={name: count for name, count in counts.items() if count},
            latencies={each.path: spread(each.ensemble.action.latency) for each in near},
            ended={each.path: {str(how): count for how, count in each.ensemble.action.ended.items()} for each in near},
        )

    def _dropped_on_streams(self) -> int:
        """Return how much was dropped on all channels; of thousands, as it was some seconds ago."""
        channels, now = self._runtime.channels, self._runtime.now()
        if self._summed is None or now - self._summed[0] >= _SECOND * (len(channels) // 1_000):
            self._summed = now, sum([channel.dropped for channel in channels])
        return self._summed[1]

    # -- Commands ------------------------------------------------------------------------------------------------

    def command(self, command: str, ensemble: str) -> None:
        """Command an ensemble, by its path: ``start``, ``stop``, ``reset`` or ``release``.

        Raises:
            Error: If there is no such ensemble or command.
        """
        found = self._by_path.get(ensemble)
        if found is None:
            raise Error(f"there is no ensemble {ensemble!r}")
        if command not in {"start", "stop", "reset", "release"}:
            raise Error(f"there is no command {command!r}; there are start, stop, reset, release")
        getattr(found.ensemble, command)()

    def sense(self, predicate: str, value: bool | None) -> None:
        """Set a predicate that no sensor tells, by its name in the scene.

        Raises:
            Error: If there is no such predicate, or a sensor tells it.
        """
        for each, (manager, name) in zip(self.scene().predicates, self._owners, strict=True):
            if each.name == predicate and each.settable:
                manager.sense(name, value)
                return
        raise Error(f"there is no predicate {predicate!r} that a page may set")

    async def explain(self, ensemble: str, _: float | None = None) -> Why | None:
        """Return why an ensemble has decided as it did last, computed on a thread; None where there is no such one."""
        found = self._by_path.get(ensemble)
        if found is None:
            return None
        try:
            case = found.ensemble.case()
        except Error as error:
            return Why(f"Nothing tells why: {error}.")
        return await asyncio.to_thread(why, case)

    async def draw(self, ensemble: str, _: float | None = None, opened: Collection[int] = ()) -> tuple[Picture, ...]:
        """Return pictures of an ensemble's policy and hierarchy, made on a thread; none where there is no such one."""
        found = self._by_path.get(ensemble)
        if found is None:
            return ()
        case = case_of(found.ensemble)
        with suppress(Error):  # where nothing was decided, there is no way to light
            case = found.ensemble.case()._replace(states=case.states)
        frames = zip(self._ensembles, self._frames, strict=True)
        running = {each.path: [life.action for life in frame.live] or [frame.action] for each, frame in frames}
        return await asyncio.to_thread(pictures, case, self.scene().ensembles, ensemble, running, opened=opened)


def _searched(told: Any) -> str:
    return (
        f"{told.searched:,} of {told.asked:,} questions searched, {told.fallbacks:,} by the fallback, "
        f"{told.late:,} late; {told.expansions:,} leaves expanded"
    )


def spread(histogram: Histogram) -> Spread:
    """Return a histogram of latencies as a frame has it."""
    buckets = [
        (round(2.0 ** (place // 8) * (1 + (place % 8 + 1) / 8)) / 1e9, count)
        for place, count in enumerate(histogram.counts)
        if count
    ]
    half, most = histogram.quantile(0.5), histogram.quantile(0.99)
    return Spread(histogram.count, half, most, histogram.maximum, tuple(buckets))


_LAYER = {
    "role": "this agent is",
    "leader": "led by",
    "term": "the leader's term",
    "step": "step",
    "commits": "steps committed",
    "late": "messages that came late",
}
"""The facts of an ensemble that a team decides, in words."""


def _teams(members: list[Member]) -> dict[str, dict[str, str]]:
    """Return how an agent's team is: agents and their links, and where each ensemble's agreement stands."""
    told: dict[str, dict[str, str]] = {}
    for member in members:
        statistics, transport = member.statistics(), member.link.transport.statistics()
        for agent in member.team.names:
            if agent == member.agent:
                told[f"agent {agent}"] = {"is": "this agent"}
                continue
            facts = {"link": "live" if agent in statistics.live else "lost"}
            silence, rounds = member.link.ages.get(agent), transport.round_trips.get(agent)
            if silence is not None:
                facts["last heard"] = f"{silence:.1f} s ago"
            if rounds:
                facts["round trip"] = f"{1e3 * rounds.quantile(0.5):.3g} ms"
            came = sum(
                each.messages for key, each in transport.received.items() if owner_of(key, member.team.name) == agent
            )
            facts["messages lost"] = f"{(lost := transport.lost.get(agent, 0)):,} of {came + lost:,}"
            told[f"agent {agent}"] = facts
        dropped = ", ".join(f"{count:,} {reason}" for reason, count in transport.dropped.items())
        told["messages"] = {
            "sent": f"{sum(each.messages for each in transport.sent.values()):,}",
            "received": f"{sum(each.messages for each in transport.received.values()):,}",
            **({"dropped": dropped} if dropped else {}),
        }
        for name, layer in statistics.layers.items():
            words = {**_LAYER, "term": _LAYER["term"] if hasattr(layer, "leader") else "episode"}
            facts = {
                word: str(value) for key, word in words.items() if (value := getattr(layer, key, None)) is not None
            }
            told[f"ensemble {name}"] = facts
    return told
