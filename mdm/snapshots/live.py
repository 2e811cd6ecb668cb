"""Snapshots of a running system, read between turns: no decision waits for more than one of them.

Nothing subscribes to what decisions publish, which would cost each of them: decisions are counted, and the last one is
read. Modes, faults, idleness and actions that last are rare, and each of them is heard.
"""

from __future__ import annotations

import asyncio
import time as times
from bisect import bisect_left
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.actors import Ensemble, EnsembleStatus, PredicateManager
from mdm.errors import Error, ModelError
from mdm.faults import KINDS
from mdm.maps.places import Places
from mdm.messages import Action, ActionLife, Observation, Progress, Reward, State
from mdm.runtime.actor import descendants
from mdm.snapshots.beliefs import belief_frame, grid_factors
from mdm.snapshots.causes import cause_in_words, changes, wired
from mdm.snapshots.events import Ring, value_of
from mdm.snapshots.floors import floors_of, robot_frame
from mdm.snapshots.frame import CauseFrame, Detail, EnsembleFrame, Frame, LifeFrame, Spread, StatisticsFrame
from mdm.snapshots.lookout import Lookout
from mdm.snapshots.observations import at_state, observed, on_observing
from mdm.snapshots.scene import EnsembleScene, FactorScene, PredicateScene, Scene
from mdm.snapshots.why import Why, case_of, why
from mdm.team import Member
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from mdm.messages import Fault, Idle, Mode
    from mdm.models import Space
    from mdm.runtime import Actor, Histogram, Runtime
    from mdm.runtime.channel import Subscription

__all__ = ["LiveRun", "expected_return", "factors_of", "remedy_of"]

_LISTED = 64
"""Symbols of a factor that are listed in a scene."""
_VALUED = 10_000
"""States up to which the policy is asked for its value."""
_SECOND = 1_000_000_000
_encode = msgspec.json.Encoder().encode
_UNSEEN: Any = object()
"""In place of the value of a predicate that has not been looked at, and may be unknown."""
_ALL = 50
"""Ensembles up to which each frame looks at all: to look at one costs ten microseconds, and a thousand have turns."""
_TURNS = 20
"""Ensembles that have their turn in a frame, whatever has changed; a quarter of them where a second has passed."""
_CHANGED = 100
"""Ensembles that have changed and are looked at in a frame: of more, the others are in the next ones.

Those whose mode has changed are looked at besides. So a frame keeps decisions waiting for some milliseconds, and comes
several times a second, where a thousand ensembles decide all the time.
"""


def remedy_of(kind: str) -> str:
    """Return what to do about a kind of fault; empty where it is none of the library's."""
    return KINDS[kind].remedy if kind in KINDS else ""


def factors_of(space: Space | None, ensemble: Ensemble | None = None) -> tuple[FactorScene, ...]:
    """Return the factors of a space of states as a scene has them, and the predicates of an ensemble that tell them."""
    layer = None if ensemble is None else ensemble.state
    if space is None:  # of a policy without a model: the factors as they are wired
        wired = [] if layer is None else [(each.name, tuple(each.predicates)) for each in layer.factors]
        return tuple([FactorScene(name, (), told if len(told) <= _LISTED else ()) for name, told in wired])
    told_by = {} if layer is None else {each.name: tuple(each.predicates) for each in layer.factors}
    return tuple(
        [
            FactorScene(each.name, tuple(each.names), told_by.get(each.name, ()))
            if len(each) <= _LISTED
            else FactorScene(each.name, ())
            for each in space.factors
        ]
    )


class _Ensemble:
    """An ensemble, and its last frame for as long as nothing changes."""

    __slots__ = (
        "_frame",
        "_key",
        "actions",
        "believed",
        "cause",
        "decided",
        "decisions",
        "detail",
        "ensemble",
        "lookout",
        "path",
        "stale",
        "urgent",
        "wired",
    )

    def __init__(self, ensemble: Ensemble, lookout: Lookout) -> None:
        self.ensemble = ensemble
        self.lookout = lookout
        self.stale = True
        self.urgent = False
        self.path = ensemble.path
        self.actions = ensemble.channel("action", Action)
        self.decisions = 0  # the first picture tells those so far, by the last of them
        self.cause = ""  # of the last decision, in words
        self.decided: Action | None = None  # the last decision that was seen
        self.wired = wired(ensemble)
        self.detail: tuple[Any, Detail] | None = None
        self.believed: tuple[Any, Any] | None = None
        self._key: tuple[Any, ...] = ()
        self._frame: EnsembleFrame | None = None

    def frame(self, seconds: Callable[[int], float], now: float) -> EnsembleFrame:
        """Return how the ensemble is."""
        self.stale = self.urgent = False
        ensemble = self.ensemble
        self.lookout.observe()
        status = ensemble.status()
        odd, living = self.lookout.look(now, status), ensemble.action.lives.living
        if self._frame is None or (status, living, odd) != self._key:
            self._key, self._frame = (status, living, odd), self._made(seconds, status, living, odd)
        return self._frame

    def look_at_cause(self, action: Action, count: int) -> str:
        """Return why the last decision was made then, in words, and take it as the one before the next.

        Args:
            action: The decision.
            count: How many there were since the last one that was seen.
        """
        ensemble = self.ensemble
        before, self.decided = self.decided if count == 1 else None, action
        changed, ended = "", None
        if before is not None:
            changed = changes(self.wired, before.state, action.state)
            ended = self.lookout.ended
            if ended is not None and ended.action != self.ensemble.joint_name(before.index):
                ended = None  # of a plain function nothing is heard
        cause = ensemble.status().cause
        self.cause = cause_in_words(cause, observed=self.lookout.latest, changed=changed, ended=ended)
        return self.cause

    def decided_at(self, action: Action) -> str:
        """Return the state or observation of a decision, by name; empty where neither is known."""
        if self.ensemble.controller.takes != "state" or action.state is None:
            return on_observing(self.lookout.latest)
        return at_state(self.ensemble.controller.symbols.state_space, action.state)

    def _made(
        self,
        seconds: Callable[[int], float],
        status: EnsembleStatus,
        living: Iterable[Any],
        odd: tuple[str, ...],
    ) -> EnsembleFrame:
        since = status.idle_since
        last: Action | None = self.actions.last  # type: ignore[assignment]
        return EnsembleFrame(
            mode=status.mode,
            since=seconds(status.since),
            causes=tuple([CauseFrame(c.kind, c.detail, seconds(c.since), remedy_of(c.kind)) for c in status.causes]),
            waiting=status.waiting,
            idle=None if since is None else seconds(since),
            live=tuple([LifeFrame(life.name, seconds(life.action.time)) for life in living]),
            epoch=-1 if last is None else last.epoch,
            action="" if last is None else self.ensemble.joint_name(last.index),
            decisions=status.decisions,
            odd=odd,
        )


class LiveRun:
    """A running system, for those who look at it.

    Args:
        runtime: The runtime, which runs.
        title: What it is called.
        control: Whether commands are taken.

    Attributes:
        ring: Its events.
        generation: Counts the scenes: it grows when ensembles, predicates or floors come or go.
    """

    def __init__(self, runtime: Runtime, *, title: str = "", control: bool = False) -> None:
        self._runtime = runtime
        self._guard = runtime.guard("the page")
        self._title = title
        self._control = control
        self._epoch = runtime.now()
        self._began = times.time_ns()
        self._seen = -1
        self._ensembles: list[_Ensemble] = []
        self._by_path: dict[str, _Ensemble] = {}
        self._place_of: dict[str, int] = {}
        self._frames: list[EnsembleFrame] = []
        self._encoded: list[msgspec.Raw] = []
        self._turn = self._next = 0
        self._turned = self._epoch
        self._managers: list[PredicateManager] = []
        self._predicates: list[PredicateScene] = []
        self._owners: list[tuple[PredicateManager, str]] = []
        self._places: list[Places] = []
        self._members: list[Member] = []
        self._values: tuple[Any, ...] = ()
        self._changed: list[float] = []
        self._counted = -_SECOND
        self._statistics: StatisticsFrame | None = None
        self._summed: tuple[int, int] | None = None
        self._team: dict[str, dict[str, str]] = {}
        self._scene: Scene | None = None
        self._subscriptions: list[Subscription[Any]] = []
        self.ring = Ring()
        self.generation = 0

    def open(self) -> None:
        """Hear what is rare."""
        runtime = self._runtime
        self._subscriptions = [
            runtime.modes.subscribe(self._guard(self._on_mode)),
            runtime.faults.subscribe(self._guard(self._on_fault)),
            runtime.idles.subscribe(self._guard(self._on_idle)),
        ]

    def close(self) -> None:
        """Hear nothing more."""
        for subscription in self._subscriptions:
            subscription.cancel()
        self._subscriptions.clear()
        for each in self._ensembles:
            each.ensemble.action.observer = None

    def _seconds(self, time: int) -> float:
        return round((time - self._epoch) / 1e9, 6)

    @property
    def now(self) -> float:
        """Seconds since the run's second 0."""
        return self._seconds(self._runtime.now())

    def _is_stale(self, path: str) -> None:
        if (found := self._by_path.get(path)) is not None:
            found.stale = found.urgent = True

    # -- Events --------------------------------------------------------------------------------------------------

    def _on_mode(self, mode: Mode) -> None:
        causes = "; ".join(f"{cause.kind}: {cause.detail}" for cause in mode.causes)
        self.ring.add(self._seconds(mode.time), "mode", mode.ensemble, mode.mode, detail=causes)
        self._is_stale(mode.ensemble)

    def _on_fault(self, fault: Fault) -> None:
        remedy = remedy_of(fault.kind)
        self.ring.add(self._seconds(fault.time), "fault", fault.source, fault.kind, detail=fault.detail, remedy=remedy)

    def _on_idle(self, idle: Idle) -> None:
        status = "idle" if idle.idle else "busy"
        detail = "intended" if idle.intended else ""
        self.ring.add(self._seconds(idle.since), "idle", idle.ensemble, idle.action, status=status, detail=detail)
        self._is_stale(idle.ensemble)

    def _on_life(self, life: ActionLife) -> None:
        self.ring.add(
            *(self._seconds(life.time), "life", life.ensemble, life.action),
            detail=life.detail,
            status=life.status,
            life=life.life,
        )
        if (found := self._by_path.get(life.ensemble)) is not None:
            found.lookout.hear(life)
            found.stale = True

    def _on_odd(self, path: str, time: float, rule: str, status: str, number: int, text: str) -> None:
        self.ring.add(time, "odd", path, rule, detail=text, status=status, life=number)

    # -- The scene -----------------------------------------------------------------------------------------------

    def scene(self) -> Scene:
        """Return what there is; made anew where actors have come or gone."""
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
            met = {id(each.ensemble): each for each in self._ensembles}
            self._ensembles = [met.get(id(ensemble)) or self._met(ensemble) for ensemble in ensembles]
            self._by_path = {each.path: each for each in self._ensembles}
            self._place_of = {each.path: place for place, each in enumerate(self._ensembles)}
            self._frames = [each.frame(self._seconds, self.now) for each in self._ensembles]
            self._encoded = [msgspec.Raw(_encode(frame)) for frame in self._frames]
        self._managers = [actor for actor in actors if isinstance(actor, PredicateManager)]
        self._places = [actor for actor in actors if isinstance(actor, Places)]
        self._members = [actor for actor in actors if isinstance(actor, Member)]
        known = {
            (id(manager), name): (value, changed)
            for (manager, name), value, changed in zip(self._owners, self._values, self._changed, strict=True)
        }
        self._owners = [(manager, name) for manager in self._managers for name in manager.values()]
        found = [known.get((id(manager), name), (_UNSEEN, self.now)) for manager, name in self._owners]
        self._values = tuple([value for value, _ in found])
        self._changed = [changed for _, changed in found]
        scene = self._made_scene(ensembles)
        if scene != self._scene:
            self._scene = scene
            self.generation += 1
            self._counted = -_SECOND  # who has just come, such as a team, is counted with the next frame

    def _met(self, ensemble: Ensemble) -> _Ensemble:
        ensemble.action.observer = self._guard(self._on_life)
        lookout = Lookout(ensemble, self._seconds, partial(self._on_odd, ensemble.path))
        for life in ensemble.action.lives.living:  # which began before this was known
            time = self._seconds(life.action.time)
            self.ring.add(time, "life", ensemble.path, life.name, status="running", life=life.number)
            lookout.hear(ActionLife(life.action.time, ensemble.path, life.number, life.name, "running"))
        return _Ensemble(ensemble, lookout)

    def _made_scene(self, ensembles: list[Ensemble]) -> Scene:
        several = len(self._managers) > 1
        return Scene(
            version=__version__,
            source="live",
            title=self._title,
            began=self._began,
            first=0.0,
            last=0.0,
            ensembles=tuple(_scenes(ensembles)),
            predicates=tuple(
                [
                    PredicateScene(
                        f"{manager.path}/{name}" if several else name,
                        manager.declared.definition(name),
                        name in manager.settable,
                    )
                    for manager, name in self._owners
                ]
            ),
            floors=tuple([floor for places in self._places for floor in floors_of(places)]),
            control=self._control,
        )

    # -- Frames --------------------------------------------------------------------------------------------------

    def frame(self, close: Collection[str] = ()) -> Frame:
        """Return how everything is.

        Args:
            close: The paths of ensembles that are looked at closely.
        """
        self._look_around()
        now = self._runtime.now()
        seconds = self._seconds(now)
        for place in self._due(now, close):
            each = self._ensembles[place]
            frame = each.frame(self._seconds, seconds)
            if frame is not self._frames[place]:
                self._frames[place], self._encoded[place] = frame, msgspec.Raw(_encode(frame))
            last: Any = each.actions.last  # none where the ensemble has ended, and begun once more
            if each.decisions != frame.decisions and last is not None:
                count = frame.decisions - each.decisions
                cause = each.look_at_cause(last, count)
                self.ring.add(
                    *(self._seconds(last.time), "decision", each.path, frame.action),
                    detail=cause,
                    life=frame.epoch,
                    count=count,
                    at="" if each.ensemble.status().cause == "observation" else each.decided_at(last),
                )
                each.decisions = frame.decisions
        self._look_at_predicates(now)
        if now - self._counted >= _SECOND:
            self._counted = now
            self._statistics = self._count(close)
            self._team = {} if not self._members else _teams(self._members)
        return Frame(
            time=self._seconds(now),
            ensembles=tuple(self._with_progress(self._frames)),
            predicates=self._values,
            changed=tuple(self._changed),
            details={path: self._detail(self._by_path[path]) for path in close if path in self._by_path},
            robots=tuple(
                [
                    robot
                    for places in self._places
                    if (robot := robot_frame(places, places.pose, places.heading_for)) is not None
                ]
            ),
            statistics=self._statistics,
            team=self._team,
        )

    def encoded(self, close: Collection[str] = ()) -> bytes:
        """Return how everything is, as JSON; what has not changed is not encoded again.

        Args:
            close: The paths of ensembles that are looked at closely.
        """
        frame = self.frame(close)
        pairs = zip(frame.ensembles, self._frames, self._encoded, strict=True)
        ensembles: Any = tuple([kept if one is two else msgspec.Raw(_encode(one)) for one, two, kept in pairs])
        return _encode(msgspec.structs.replace(frame, ensembles=ensembles))

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

    def _look_at_predicates(self, now: int) -> None:
        known = {id(manager): manager.values() for manager in self._managers}
        values = tuple([known[id(manager)].get(name) for manager, name in self._owners])
        if values != self._values:
            assert self._scene is not None
            seconds = self._seconds(now)
            for place, (value, before) in enumerate(zip(values, self._values, strict=True)):
                if value is not before:
                    self._changed[place] = seconds
                    name = self._scene.predicates[place].name
                    self.ring.add(seconds, "predicate", self._owners[place][0].path, name, status=value_of(value))
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

    def _detail(self, each: _Ensemble) -> Detail:
        ensemble = each.ensemble
        state: Any = ensemble.channel("state", State, retain=True).last
        observation: Any = ensemble.channel("observation", Observation).last
        action: Any = each.actions.last
        current = ensemble.controller.decided_by
        key = (state, observation, action, current)
        if each.detail is not None and all(one is two for one, two in zip(key, each.detail[0], strict=True)):
            return each.detail[1]
        detail = self._made_detail(each, *key)
        each.detail = key, detail
        return detail

    def _made_detail(self, each: _Ensemble, state: Any, observation: Any, action: Any, current: Any) -> Detail:
        controller = each.ensemble.controller
        symbols, space = controller.symbols, controller.symbols.state_space
        reward: Any = each.ensemble.channel("reward", Reward, retain=True).last
        believed = None
        if controller.takes != "state":
            if each.believed is None or each.believed[0] is not current:
                each.believed = current, belief_frame(current, space)
            believed = each.believed[1]
        decided_on = controller.takes == "state" and action is not None and action.state is not None
        return Detail(
            state=None if not decided_on else str(action.state) if space is None else space.names[action.state],
            factors=_factors(space, space.unravel(action.state) if decided_on and space else state and state.values),
            observation=None
            if observation is None
            else observed(
                symbols.observation_space, observation.values if observation.index is None else observation.index
            ),
            cause=each.cause,
            decided=None if action is None else self._seconds(action.time),
            reward=None if reward is None or action is None or reward.epoch != action.epoch else reward.value,
            value=expected_return(controller, action.state if decided_on else current),
            belief=believed,
            search=_searched(each.ensemble.layer_statistics().get("planner")),
            observations=each.lookout.history,
            tally=each.lookout.tally,
        )

    def _count(self, close: Collection[str]) -> StatisticsFrame:
        runtime = self._runtime
        told = runtime.dispatcher.statistics()
        counts: dict[str, float] = {
            "turns": told.turns,
            "turns cut short": told.interrupted,
            "messages of threads": told.from_threads,
            "replaced by newer ones": told.replaced,
            "lost": told.lost,
            "refused": told.refused,
            "dropped on streams": self._dropped_on_streams(),
        }
        if runtime.recorder is not None:
            counts["lost of the record"] = runtime.recorder.statistics().dropped
        counts["lost of the page"] = self._guard.lost
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
        found = next((each.ensemble for each in self._ensembles if each.path == ensemble), None)
        if found is None:
            raise Error(f"there is no ensemble {ensemble!r}")
        if command not in {"start", "stop", "reset", "release"}:
            raise Error(f"there is no command {command!r}: start, stop, reset, release")
        getattr(found, command)()

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
        found = next((each.ensemble for each in self._ensembles if each.path == ensemble), None)
        if found is None:
            return None
        try:
            case = case_of(found)
        except Error as error:
            return Why(f"Nothing tells why: {error}.")
        return await asyncio.to_thread(why, case)


def _scenes(ensembles: list[Ensemble]) -> Iterable[EnsembleScene]:
    """Yield the scenes of ensembles, each behind the one above it."""
    places = {id(ensemble): place for place, ensemble in enumerate(ensembles)}
    for ensemble in ensembles:
        above: Actor | None = ensemble.parent
        while above is not None and not isinstance(above, Ensemble):
            above = above.parent
        bound = ""
        if above is not None:
            bindings = zip(above.action.names, above.action.bindings, strict=True)
            bound = next((name for name, binding in bindings if binding.ensemble is ensemble), "")
        symbols = ensemble.controller.symbols
        yield EnsembleScene(
            path=ensemble.path,
            parent=-1 if above is None else places.get(id(above), -1),
            bound=bound,
            summary=ensemble.summary(),
            actions=tuple(ensemble.action.names[:_LISTED]),
            states=symbols.num_states or 0,
            factors=factors_of(symbols.state_space, ensemble),
            grid=grid_factors(symbols.state_space) is not None,
        )


def _factors(space: Space | None, values: Sequence[int | None] | None) -> tuple[tuple[str, str | None], ...]:
    if values is None or space is None or len(values) != len(space.factors):
        return ()
    pairs = zip(space.factors, values, strict=True)
    return tuple([(factor.name, None if value is None else factor.names[value]) for factor, value in pairs])


def expected_return(controller: Any, at: Any) -> float | None:
    """Return the expected return by the policy's own values, where it has some and asking costs little."""
    states = controller.symbols.num_states
    if at is None or states is None or states > _VALUED or not hasattr(controller.policy, "value"):
        return None
    try:
        return round(float(controller.policy.value(at)), 6)
    except (ModelError, TypeError, ValueError, IndexError, NotImplementedError):
        return None


def _searched(told: Any) -> str:
    if told is None:
        return ""
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
    return Spread(
        *(histogram.count, histogram.quantile(0.5), histogram.quantile(0.99), histogram.maximum), tuple(buckets)
    )


_LAYER = {
    "role": "this agent is",
    "leader": "led by",
    "term": "the leader's term",
    "step": "step",
    "commits": "steps committed",
    "late": "messages that came late",
}
"""What is told of an ensemble that a team decides, in words."""


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
            rounds = transport.round_trips.get(agent)
            if rounds:
                facts["round trip"] = f"{1e3 * rounds.quantile(0.5):.3g} ms"
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
