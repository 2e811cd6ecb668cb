"""The predicate manager: from sensor data to predicates and events.

It owns one network of formulas, updates it in dependency order once a turn, and publishes what changed: on
``updates`` the predicates, on ``events`` the events. ``map`` hands the full map to whoever subscribes late.
"""

from __future__ import annotations

import asyncio
import re
from contextlib import contextmanager
from threading import get_ident
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from mdm.actors.predicates.backlog import Backlog
from mdm.actors.predicates.follower import Follower
from mdm.actors.predicates.sensor import EventSource, Sensor, truth
from mdm.errors import ConfigError, Error
from mdm.logic import Formula, Network, parse, similar
from mdm.messages import EventUpdate, PredicateMap, PredicateUpdate, SensorUpdate
from mdm.runtime import Actor
from mdm.runtime.clock import check_seconds
from mdm.runtime.handler import check_plain
from mdm.runtime.supervision import text_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np

    from mdm.logic import Change
    from mdm.runtime import Channel, Runtime, Supervision, Timer

__all__ = ["ACTION_END", "PredicateManager"]

T = TypeVar("T")
ACTION_END = re.compile(r".+\.(running|succeeded|failed|preempted|timed_out|abandoned)")


class PredicateManager(Actor):
    """Grounds predicates and events on sensors, and derives others by formula.

    Declare everything before it is started; sensors may be set from any thread, at any time.

    Args:
        name: Its name among actors.
        supervision: What its failure means.
    """

    def __init__(self, name: str = "predicates", *, supervision: Supervision = "escalate") -> None:
        super().__init__(name, supervision=supervision)
        self._network = Network()
        self._counter = 0
        self._event_counter = 0
        self._sensors: dict[str, Sensor] = {}
        self._groundings: list[tuple[str, Channel[Any] | tuple[str, type[Any]], Callable[[Any], bool | None]]] = []
        self._followed: list[tuple[str, Channel[PredicateUpdate], Channel[PredicateMap]]] = []
        self._declarations: dict[str, Callable[[Network], None]] = {}
        self._kinds: dict[str, Literal["predicate", "event"]] = {}
        self._formulas: dict[str, tuple[Formula, ...]] = {}
        self._used: set[str] = set()
        self._raised: set[str] = set()
        self._held_for: dict[str, int] = {}
        self._max_age: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self._hold_timers: dict[str, Timer] = {}
        self._age_timers: dict[str, Timer] = {}
        self._batches: dict[object, tuple[dict[str, bool | None], list[str]]] = {}
        self._backlog = Backlog()
        self._known: frozenset[str] = frozenset()
        self._senses: Callable[[SensorUpdate], None] | None = None
        self._begun = False
        self._lost = False
        self._home: Runtime | None = None
        self.action_ends: frozenset[str] = frozenset()
        self._first_events: EventUpdate | None = None

    # -- Declarations --------------------------------------------------------------------------------------------

    def sensor(
        self,
        name: str,
        channel: Channel[T] | tuple[str, type[T]] | None = None,
        when: Callable[[T], bool | None] | None = None,
        *,
        max_age: float | None = None,
        initial: bool | None = None,
    ) -> Sensor:
        """Declare a predicate that sensor data decides, and return the handle to set it with.

        Args:
            name: The predicate's name.
            channel: Ground it on the messages of this channel (or of the runtime's channel of that name and type).
            when: Tells from a message whether the predicate holds; None says that it cannot be told.
            max_age: Seconds after which a value that was not refreshed becomes unknown.
            initial: Its value at start.
        """
        if (channel is None) != (when is None):
            raise ConfigError(f"predicate {name!r} needs a channel and a 'when' function, or neither", key=name)
        if max_age is not None:
            check_seconds(max_age, f"max_age of {name!r}", key=name)
        initial = truth(name, initial)
        if when is not None:
            check_plain(when, f"the 'when' of predicate {name!r}")
        self._declare(name, "predicate", lambda network: network.add_input(name, self._told(name, initial)))
        if channel is not None and when is not None:
            self._groundings.append((name, channel, when))
        if max_age is not None:
            self._max_age[name] = round(max_age * 1e9)
        sensor = self._sensors[name] = Sensor(name, self)
        return sensor

    def define(self, name: str, formula: Formula | str, *, held_for: float | None = None) -> None:
        """Declare a predicate by a formula over others.

        Args:
            name: The predicate's name.
            formula: Over predicates' names.
            held_for: Seconds for which the formula must have been true before the predicate is.
        """
        tree = _tree(formula)
        if held_for is None:
            self._declare(name, "predicate", lambda network: network.define(name, tree), tree)
        else:
            check_seconds(held_for, f"held_for of {name!r}", key=name)
            self._held_for[name] = round(held_for * 1e9)
            self._declare(name, "predicate", lambda network: network.hold(name, tree), tree)

    def latch(
        self,
        name: str,
        *,
        set: Formula | str,  # noqa: A002
        reset: Formula | str,
        initial: bool = False,
    ) -> None:
        """Declare a predicate that remembers: true from ``set`` on until ``reset``; where both hold, reset wins.

        Both are formulas over predicates and events.
        """
        on, off = _tree(set), _tree(reset)
        self._declare(
            name, "predicate", lambda network: network.latch(name, set=on, reset=off, initial=initial), on, off
        )

    def event(self, name: str, formula: Formula | str | None = None) -> EventSource:
        """Declare an event: raised through the handle returned, or when a formula becomes true."""
        if formula is None:
            self._declare(name, "event", lambda network: network.add_event(name))
            self._raised.add(name)
        else:
            tree = _tree(formula)
            self._declare(name, "event", lambda network: network.rise(name, tree), tree)
        return EventSource(name, self)

    def follow(self, agent: str, updates: Channel[PredicateUpdate], map: Channel[PredicateMap]) -> None:  # noqa: A002
        """Take another agent's predicates, known here as ``agent/Name``.

        Args:
            agent: Whose.
            updates: Its predicate manager's updates.
            map: Its map, which is read once at start, and again when the updates' counter shows that one was lost.
        """
        self._followed.append((agent, updates, map))

    def knows(self, name: str) -> Literal["predicate", "event"] | None:
        """Return what a name stands for: as declared, or by its form.

        Ends of actions, such as ``Patrol.succeeded``, are events, and ``agent/Name`` is another agent's predicate.
        """
        if name in self._kinds:
            return self._kinds[name]
        if ACTION_END.fullmatch(name):
            return "event"
        return "predicate" if "/" in name else None

    def check_input(self, name: str, kind: Literal["predicate", "event"]) -> None:
        """Refuse a name that code cannot set, or raise.

        Ends of actions and other agents' predicates are accepted where they are used.

        Raises:
            Error: If there is no such predicate or event, or it is derived; it names those closest.
        """
        if self.senses(name) if kind == "predicate" else self.raises(name):
            return
        declared = self._kinds.get(name)
        if declared is None and self.knows(name) == kind and name in self.used:
            return
        if declared == kind:
            raise Error(f"{kind} {name!r} is derived from others: give those")
        others = [other for other, its_kind in self._kinds.items() if its_kind == kind]
        hint = f": it is an {declared}" if declared == "event" else f": it is a {declared}" if declared else ""
        hint = (
            hint or similar(name, others) or f"; {'there are ' + ', '.join(others) if others else 'none is declared'}"
        )
        raise Error(f"there is no {kind} {name!r}{hint}")

    def senses(self, name: str) -> bool:
        """Whether a name is a predicate that code sets."""
        return name in self._sensors

    def derived(self, name: str) -> bool:
        """Whether a name is defined by formulas over others."""
        return bool(self._formulas.get(name))

    def raises(self, name: str) -> bool:
        """Whether a name is an event that code raises."""
        return self._kinds.get(name) == "event" and not self._formulas[name]

    def use(self, *names: str) -> None:
        """Ask for names that are known by their form, so that the network has them; call this before the start."""
        self._used.update(names)

    @property
    def used(self) -> tuple[str, ...]:
        """Every name that formulas and factors use, sorted."""
        names = {name for formulas in self._formulas.values() for formula in formulas for name in formula.names}
        return tuple(sorted(names | self._used))

    @property
    def names(self) -> dict[str, Literal["predicate", "event"]]:
        """Everything declared so far."""
        return dict(self._kinds)

    def _declare(
        self, name: str, kind: Literal["predicate", "event"], declaration: Callable[[Network], None], *used: Formula
    ) -> None:
        if name in self._kinds:
            raise ConfigError(f"{name!r} is declared twice; a name stands for one predicate or event", key=name)
        if self.life != "created":
            raise Error(f"{name!r} came too late: declare predicates and events before {self.path!r} is started")
        self._kinds[name] = kind
        self._declarations[name] = declaration
        self._formulas[name] = used

    def definition(self, name: str) -> str:
        """Return in words what decides a predicate or event: code, a formula, a latch, an action's end."""
        kind = self._kinds.get(name)
        if kind is None:
            return "an action's end" if ACTION_END.fullmatch(name) else "another agent's predicate"
        formulas = self._formulas[name]
        if len(formulas) == 2:
            return f"set by {formulas[0]}, reset by {formulas[1]}"
        if formulas:
            held = f", held for {self._held_for[name] / 1e9:g} s" if name in self._held_for else ""
            return f"{formulas[0]}{held}"
        aged = f", unknown after {self._max_age[name] / 1e9:g} s" if name in self._max_age else ""
        return f"{'raised' if kind == 'event' else 'set'} by code{aged}"

    def inputs_of(self, name: str) -> set[str]:
        """Return the names of all sensors and events that a predicate or event depends on, itself included."""
        found: set[str] = set()
        waiting = [name]
        while waiting:
            current = waiting.pop()
            if current not in found:
                found.add(current)
                waiting += [used for formula in self._formulas.get(current, ()) for used in formula.names]
        return found

    @property
    def aged(self) -> frozenset[str]:
        """The predicates that become unknown when they are not refreshed."""
        return frozenset(self._max_age)

    def network(self) -> Network:
        """Return the compiled network of what was declared, with every error that `mdm check` should see raised."""
        network = Network()
        for declare in self._declarations.values():
            declare(network)
        for name in self.used:
            if name in self._kinds:
                continue
            if ACTION_END.fullmatch(name):
                network.add_event(name)
            elif "/" in name:
                network.add_input(name, self._backlog.values.get(name))
        return network

    # -- Values --------------------------------------------------------------------------------------------------

    def value(self, name: str) -> bool | None:
        """Return a predicate's value: true, false, or None where it is unknown."""
        value = self._network.value(name)
        return None if self._lost else value

    def values(self) -> dict[str, bool | None]:
        """Return the value of every predicate."""
        values = self._network.values()
        return dict.fromkeys(values) if self._lost else values

    @contextmanager
    def batch(self) -> Iterator[None]:
        """Make all changes that are reported inside the block one update.

        It takes what this task reports, or outside of tasks this thread: others go on while the block awaits something.
        """
        scope = _scope()
        if scope in self._batches:
            yield  # the outer batch takes them all
            return
        values, events = self._batches[scope] = {}, []
        try:
            yield
        finally:
            del self._batches[scope]
            if values or events:
                self._input(tuple(values.items()), tuple(events))

    def sense(self, name: str, value: bool | np.bool_ | None) -> None:
        """Take a predicate's value, by its name. From any thread.

        Raises:
            Error: If code cannot set a predicate of that name, or the value is no truth value.
        """
        if name not in self._sensors:
            self.check_input(name, "predicate")
        self.take(((name, truth(name, value)),))

    def take(self, readings: tuple[tuple[str, bool | None], ...]) -> None:
        """Take values of predicates as one update; `Sensor.set` calls this. From any thread."""
        if self._batches and (batch := self._batches.get(_scope())) is not None:
            batch[0].update(readings)
        elif self._senses is None:
            self._input(readings, ())
        else:
            self._senses(SensorUpdate(self._now(), readings))

    def occur(self, *events: str) -> None:
        """Raise events, together; `EventSource.fire` calls this. From any thread. Before the start nothing hears them.

        Raises:
            Error: If code cannot raise an event of that name.
        """
        for name in events:
            if name not in self._raised:
                self.check_input(name, "event")
        if self._batches and (batch := self._batches.get(_scope())) is not None:
            batch[1].extend(events)
        else:
            self._input((), events)

    def _told(self, name: str, initial: bool | None) -> bool | None:
        """What a sensor was told before the start; at a restart it is unknown otherwise, whatever it began with."""
        return self._backlog.values.get(name, None if self._begun else initial)

    def _input(self, predicates: tuple[tuple[str, bool | None], ...], events: tuple[str, ...]) -> None:
        if not self._begun:
            self._backlog.put(predicates, None)
            return
        (self._senses or self._keep)(SensorUpdate(self.runtime.clock.now(), predicates, events))

    def _keep(self, update: SensorUpdate) -> None:
        self._backlog.put(update.predicates, update.time)
        self.sensed.publish(update)

    def keep(self) -> None:
        """Keep what sensors are told from now on for the next start, too: one who uses them has failed."""
        if self._senses is not None:
            self._senses = self._keep

    def keep_no_more(self) -> None:
        """Take it that the manager lives on."""
        if self._senses is not None and self.life == "running" and not self.failing:
            self._senses = self.sensed.publish
            self._backlog.clear()

    @property
    def known(self) -> frozenset[str]:
        """The names of all predicates in the running network."""
        return self._known

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Build the network, ground it, and make its first values known."""
        self.sensed = self.channel("sensed", SensorUpdate)
        self.sensed.supersedes = _subject
        self.sensed.merge = _merge
        self.updates = self.channel("updates", PredicateUpdate)
        self.events = self.channel("events", EventUpdate)
        self.map = self.channel("map", PredicateMap)
        self._now = self.runtime.clock.reader()
        self._senses = self.sensed.publish
        now = self.runtime.clock.now()
        self._begun = self._home is self.runtime
        self._home = self.runtime
        if self._begun:
            self._backlog.expire(now, self._max_age)
        self._network = self.network()
        for name in self._max_age:
            self._seen[name] = self._backlog.told(name, now) if self._begun else now
        self._backlog.clear()
        self._begun = True
        self._lost = False
        first = self._network.compile()
        self._known = frozenset(self._network.names)
        ends = {name for name in self._network.events if ACTION_END.fullmatch(name)}
        self.action_ends = frozenset(name for name in ends if name not in self._kinds or self.raises(name))
        self._raised |= self.action_ends
        self._counter = self._event_counter = 0
        self._hold_timers.clear()
        self._age_timers.clear()
        self._first_events = EventUpdate(now, 0, first.events) if first.events else None
        self.map.retain_by(lambda: PredicateMap(self.runtime.clock.now(), self._counter, self.values()))
        self.events.retain_by(lambda: self._first_events if self._event_counter == 0 else None)
        for name in first.armed:
            self._arm(name, now)
        for name in self._max_age:
            if self._network.value(name) is not None:
                self._watch(name)
        values = self._network.values()
        unknown = tuple(name for name, value in values.items() if value is None)
        self._counter = 1
        self.updates.publish(PredicateUpdate(now, 1, first.rising, first.falling, unknown))
        self.subscribe(self.sensed, self._sensed)
        for name, place, when in self._groundings:
            channel = self.runtime.channel(*place) if isinstance(place, tuple) else place
            self.subscribe(channel, self._grounding(name, when))
        for agent, updates, full in self._followed:
            follower = Follower(self, agent, full)
            self.subscribe(updates, follower.update)
            follower.synchronise()

    def on_failing(self, error: BaseException) -> None:  # noqa: ARG002 - as of any actor
        """Let every predicate be unknown at once; what sensors are told from now on is kept for the next start."""
        self.keep()
        known = tuple(name for name, value in self.values().items() if value is not None)
        self._lost = True
        if known:
            self._counter += 1
            self.updates.publish(PredicateUpdate(self.runtime.clock.now(), self._counter, (), (), known))

    def on_stop(self) -> None:
        """Keep what sensors are told from now on for the next start."""
        self._senses = None

    def _sensed(self, update: SensorUpdate) -> None:
        predicates = update.predicates if not self._max_age else self._fresh(update)
        try:
            change = self._network.update(predicates, update.events)
        except Error as error:
            self.report("sensor", str(error), time=update.time)
            return
        if self._max_age:
            for name, value in predicates:
                if name in self._max_age:
                    self._seen[name] = update.time
                    if value is not None and name not in self._age_timers:
                        self._watch(name)
        if change is None:
            return
        rising, falling, unknown, events, armed, disarmed = change
        if events or armed or disarmed or self.map.heard:
            self._publish(update.time, change)
        else:  # hot path: predicates alone have changed
            self._counter = counter = self._counter + 1
            message = PredicateUpdate(update.time, counter, rising, falling, unknown)
            self.updates.emit_on(message, rising, falling, unknown)

    def _fresh(self, update: SensorUpdate) -> tuple[tuple[str, bool | None], ...]:
        """Return the values of an update, unknown where they waited for longer than they hold."""
        age = self._now() - update.time
        limits = self._max_age
        stale = [name for name, value in update.predicates if value is not None and age > limits.get(name, age)]
        if not stale:
            return update.predicates
        self.report("stale", f"values of {', '.join(stale)} waited {age / 1e9:.3g} s, longer than they hold")
        return tuple((name, None if name in stale else value) for name, value in update.predicates)

    def _publish(self, time: int, change: Change) -> None:
        rising, falling, unknown, events, armed, disarmed = change
        if armed or disarmed:
            for name in disarmed:
                timer = self._hold_timers.pop(name, None)
                if timer is not None:
                    timer.cancel()
            for name in armed:
                self._arm(name, time)
        if rising or falling or unknown:
            self._counter = counter = self._counter + 1
            message = PredicateUpdate(time, counter, rising, falling, unknown)
            self.updates.emit_on(message, rising, falling, unknown)
            if self.map.heard:
                self.map.publish(PredicateMap(time, counter, self._network.values()))
        if events:
            self._event_counter = counter = self._event_counter + 1
            self.events.emit_on(EventUpdate(time, counter, events), events)

    def _arm(self, name: str, since: int) -> None:
        def held() -> None:
            del self._hold_timers[name]
            when = self.runtime.clock.now()
            change = self._network.update((), (), (name,))
            if change:
                self._publish(when, change)

        self._hold_timers[name] = self.call_at(since + self._held_for[name], held)

    def _watch(self, name: str) -> None:
        """Wait until a sensor's value is too old; the timer is moved on lazily, not at each refresh."""
        max_age = self._max_age[name]

        def look() -> None:
            now = self.runtime.clock.now()
            if self._seen[name] + max_age > now:
                self._age_timers[name] = self.call_at(self._seen[name] + max_age, look)
                return
            del self._age_timers[name]
            change = self._network.update(((name, None),))
            if change:
                self.report("stale", f"predicate {name!r} was not refreshed for {max_age / 1e9:g} s", time=now)
                self._publish(now, change)

        self._age_timers[name] = self.call_at(self._seen[name] + max_age, look)

    def _grounding(self, name: str, when: Callable[[Any], bool | None]) -> Callable[[Any], None]:
        sensor = self._sensors[name]

        def grounded(message: object) -> None:
            try:
                sensor.set(when(message))
            except Exception as error:
                self.report(
                    "sensor", f"the 'when' of predicate {name!r} raised {type(error).__name__}: {text_of(error)}"
                )
                sensor.set(None)

        return grounded


def _subject(update: SensorUpdate) -> tuple[str, ...] | None:
    """Return whose values a newer update of the same predicates supersedes; None where events must keep their order."""
    return None if update.events else tuple(name for name, _ in update.predicates)


def _merge(older: SensorUpdate, newer: SensorUpdate) -> SensorUpdate:
    """Return the latest values of two updates without events; they are as old as the older one."""
    return SensorUpdate(older.time, tuple({**dict(older.predicates), **dict(newer.predicates)}.items()))


def _scope() -> object:
    """Return what runs: an asyncio task, or else a thread."""
    try:
        return asyncio.current_task() or get_ident()
    except RuntimeError:  # no event loop runs here
        return get_ident()


def _tree(formula: Formula | str) -> Formula:
    return parse(formula) if isinstance(formula, str) else formula
