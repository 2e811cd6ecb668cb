"""The predicate manager: from sensor data to predicates and events.

It owns one network of formulas, updates it in dependency order once a turn, and publishes the changes: on
``updates`` the predicates, on ``events`` the events. ``map`` hands the full map to late subscribers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar, cast

from mdm.actors.predicates.declarations import ACTION_END, Declarations
from mdm.actors.predicates.sources import Backlog, Batch, Batches, EventSource, Follower, NumberSensor, Sensor, truth
from mdm.errors import ConfigError, Error
from mdm.logic import Formula, Monitor, Network, parse, parse_threshold, similar
from mdm.messages import EventUpdate, PredicateMap, PredicateUpdate, SensorUpdate
from mdm.runtime import Actor
from mdm.runtime.channel import Topics
from mdm.runtime.handler import check_plain
from mdm.runtime.supervision import text_of
from mdm.runtime.time.clock import check_seconds
from mdm.stimuli import Kept

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import TypeAlias

    import numpy as np

    from mdm.actors.predicates.declarations import Kind
    from mdm.actors.predicates.sources import Readings
    from mdm.checks import Number
    from mdm.logic import Change
    from mdm.runtime import Channel, Runtime, Supervision, Timer

    Truth: TypeAlias = bool | np.bool_ | None

T = TypeVar("T")


class PredicateManager(Actor):
    """Grounds predicates and events on sensors, and derives others by formula.

    Declare everything before it is started; sensors may be set from any thread, at any time.

    Args:
        name: Its name among actors.
        supervision: How its failure is handled.

    Attributes:
        declared: The declarations.
        action_ends: The ends of actions that something here depends on, once it has started; always the same set.
    """

    # All of its own: beside an actor's other attributes they would be too many for CPython to find methods at once.
    __slots__ = (
        "_age_timers",
        "_backlog",
        "_batches",
        "_begun",
        "_counter",
        "_event_counter",
        "_first_events",
        "_followed",
        "_groundings",
        "_held_for",
        "_hold_timers",
        "_home",
        "_known",
        "_lost",
        "_max_age",
        "_network",
        "_now",
        "_open",
        "_raised",
        "_seen",
        "_senses",
        "_sensors",
        "action_ends",
        "declared",
        "events",
        "hears_holds",
        "map",
        "sensed",
        "updates",
    )

    def __init__(self, name: str = "predicates", *, supervision: Supervision = "escalate") -> None:
        super().__init__(name, supervision=supervision)
        self._network = Network()
        self._counter = 0
        self._event_counter = 0
        self.declared = Declarations()
        self._sensors: dict[str, Sensor] = {}
        self._groundings: list[tuple[str, Channel[Any] | tuple[str, type[Any]], Callable[[Any], Truth]]] = []
        self._followed: list[tuple[str, Channel[PredicateUpdate], Channel[PredicateMap]]] = []
        self._raised: set[str] = set()
        self._held_for = self.declared.held_for
        self._max_age = self.declared.max_age
        self._seen: dict[str, int] = {}
        self._hold_timers: dict[str, Timer] = {}
        self.hears_holds: list[Callable[[str], None]] = []
        self._age_timers: dict[str, Timer] = {}
        self._batches = Batches(self._input)
        self._open = self._batches.open
        self._backlog = Backlog()
        self._known: frozenset[str] = frozenset()
        self._senses: Callable[[SensorUpdate], None] | None = None
        self._begun = False
        self._lost = False
        self._home: Runtime | None = None
        self.action_ends: set[str] = set()
        self._first_events: EventUpdate | None = None

    # -- Declarations --------------------------------------------------------------------------------------------

    def sensor(
        self,
        name: str,
        channel: Channel[T] | tuple[str, type[T]] | None = None,
        when: Callable[[T], Truth] | str | None = None,
        *,
        max_age: Number | None = None,
        initial: bool | np.bool_ | None = None,
    ) -> Sensor:
        """Declare a predicate that sensor data decides, and return the handle to set it with.

        Args:
            name: The predicate's name.
            channel: Ground it on the messages of this channel (or of the runtime's channel of that name and type).
            when: Tells from a message whether the predicate holds; None says that it cannot be told. Or without a
                channel a threshold, by which it is told numbers: ``"< 0.2 until > 0.3"`` is true from below 0.2 until
                above 0.3, and in between as before; ``"< 0.2"`` is false from 0.2 on. Numbers that lie in between at
                the start, and NaN, leave it unknown.
            max_age: Seconds after which a value that was not refreshed becomes unknown.
            initial: Its value at start.
        """
        threshold = parse_threshold(when) if isinstance(when, str) and channel is None else None
        if threshold is None and (channel is None) != (when is None):
            raise ConfigError(f"predicate {name!r} needs a channel and a 'when' function, or neither", key=name)
        if max_age is not None:
            check_seconds(max_age, f"max_age of {name!r}", key=name)
        first = truth(name, initial)
        if when is not None and threshold is None:
            check_plain(when, f"the 'when' of predicate {name!r}")
        self._declare(
            name, "predicate", lambda network: network.add_input(name, self._initial(name, first)), sensed=True
        )
        if channel is not None and when is not None:
            self._groundings.append((name, channel, cast("Callable[[T], Truth]", when)))
        if max_age is not None:
            self._max_age[name] = round(max_age * 1e9)
        if first is not None:
            self.declared.initial[name] = first
        if threshold is None:
            sensor = Sensor(name, self)
        else:
            sensor = NumberSensor(name, self, threshold, first)
            self.declared.thresholds[name] = threshold
        self._sensors[name] = sensor
        return sensor

    def define(self, name: str, formula: Formula | str, *, held_for: Number | None = None) -> None:
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
            self._declare(name, "predicate", lambda network: network.hold(name, tree), tree)
            self._held_for[name] = round(held_for * 1e9)

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
        self.declared.initial[name] = bool(initial)

    def monitor(self, name: str, formula: Formula | str) -> None:
        """Declare a predicate by a formula in time, see `mdm.logic.Monitor`: false where that is for ever, else true.

        The first valuation is that of the start. The next one is there when an update changes a predicate of the
        formula, also to unknown and back. A start after a failure begins with a first one.
        """
        tree = Monitor(formula).formula
        self._declare(name, "predicate", lambda network: network.monitor(name, tree), tree)
        self.declared.monitors.add(name)

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
            agent: The other agent.
            updates: Its predicate manager's updates.
            map: Its map, which is read once at start, and again when the updates' counter shows that one was lost.
        """
        self._followed.append((agent, updates, map))

    def _declare(
        self, name: str, kind: Kind, part: Callable[[Network], None], *formulas: Formula, sensed: bool = False
    ) -> None:
        if self.life != "created" and self.declared.names.get(name) is None:
            raise Error(f"{name!r} is declared too late: declare predicates and events before {self.path!r} starts")
        self.declared.add(name, kind, part, *formulas, sensed=sensed)

    def network(self) -> Network:
        """Return the network of the declarations; its compilation raises every error that `mdm check` should see."""
        return self.declared.network(self._backlog.values)

    # -- Values --------------------------------------------------------------------------------------------------

    def value(self, name: str) -> bool | None:
        """Return a predicate's value: true, false, or None where it is unknown, as all are before the start."""
        if not self._begun and self.declared.names.get(name) == "predicate":
            return None
        value = self._network.value(name)
        return None if self._lost else value

    def values(self) -> dict[str, bool | None]:
        """Return the value of every predicate: true, false, or None where it is unknown, as before the start."""
        if not self._begun:
            return {name: None for name, kind in self.declared.names.items() if kind == "predicate"}
        values = self._network.values()
        return dict.fromkeys(values) if self._lost else values

    def verdict(self, name: str) -> bool | None:
        """Return what is known of a monitor's formula: true or false for ever, or None where that is open.

        Raises:
            Error: If there is no monitor of that name.
        """
        if name not in self.declared.monitors:
            raise Error(f"there is no monitor {name!r}{similar(name, self.declared.monitors)}")
        monitor = self._network.monitors.get(name)
        return None if monitor is None else monitor.verdict

    def batch(self) -> Batch:
        """Make all changes that are reported inside the block one update.

        It gathers this task's reports, or outside of tasks this thread's: others go on while the block awaits.
        """
        return Batch(self._batches)

    def sense(self, name: str, value: bool | np.bool_ | Number | None) -> None:
        """Take a predicate's value, or of one with a threshold the number, by its name. From any thread.

        Raises:
            Error: If code cannot set a predicate of that name, or the value is no truth value.
        """
        self.take(((name, self.truth_of(name, value)),))

    def truth_of(self, name: str, value: bool | np.bool_ | Number | None) -> bool | None:
        """Return what a predicate's sensor tells by a value.

        Raises:
            Error: As `sense`.
        """
        sensor = self._sensors.get(name)
        if sensor is None:
            self.declared.check_input(name, "predicate")
            return truth(name, value)
        return sensor.truth(value)

    def take(self, readings: Readings) -> None:
        """Take a predicate's value; `Sensor.set` calls this. From any thread."""
        if self._open and (batch := self._open.get(self._batches.scope())) is not None:
            (reading,) = readings
            batch.readings[reading[0]] = reading
        elif self._senses is None:
            self._input(readings, ())
        else:
            (_ := self._senses)(SensorUpdate((_ := self._now)(), readings))

    def occur(self, *events: str) -> None:
        """Raise events, together; `EventSource.fire` calls this. From any thread. Before the start nothing hears them.

        Raises:
            Error: If code cannot raise an event of that name.
        """
        for name in events:
            if name not in self._raised:
                self.declared.check_input(name, "event")
        if self._open and (batch := self._open.get(self._batches.scope())) is not None:
            batch.events += events
        else:
            self._input((), events)

    def derive(self, predicates: tuple[tuple[str, bool | None], ...], events: tuple[str, ...] = ()) -> None:
        """Take values of predicates, and events, that the library itself derives from other input, as one update.

        They are no input of a record's: whatever they follow from is.
        """
        if self._senses is None:
            self._input(predicates, events)
        elif self.failing:
            self._keep(SensorUpdate(self.runtime.now(), predicates, events))
        else:
            self.sensed.derive(SensorUpdate(self.runtime.now(), predicates, events))

    def _initial(self, name: str, initial: bool | None) -> bool | None:
        """A sensor's value reported before the start; else unknown at a restart, and its initial value at first."""
        return self._backlog.values.get(name, None if self._begun else initial)

    def _input(self, predicates: tuple[tuple[str, bool | None], ...], events: tuple[str, ...]) -> None:
        senses = self._senses
        if senses is not None:
            senses(SensorUpdate((_ := self._now)(), predicates, events))
        elif self._begun:
            self._keep(SensorUpdate(self.runtime.now(), predicates, events))
        else:
            self._backlog.put(predicates, None)

    def _keep(self, update: SensorUpdate) -> None:
        self._backlog.put(update.predicates, update.time)
        self.sensed.publish(update)

    def keep(self) -> None:
        """Keep sensors' reports from now on for the next start, too: an ensemble that uses them has failed."""
        if self._senses is not None:
            self._senses, self._now = self._keep, self.runtime.dispatcher.now

    def _take_in(self) -> None:
        """Send sensors' reports to the channel, with the clock's time: it gives them that of the running turn."""
        self._senses, self._now = self.sensed.publish, self.runtime.clock.reader()

    def keep_no_more(self) -> None:
        """Forget the reports that were kept: the manager lives on."""
        if self._senses is not None and self.life == "running" and not self.failing:
            self._take_in()
            self._backlog.clear()

    @property
    def known(self) -> frozenset[str]:
        """The names of all predicates in the running network."""
        return self._known

    @property
    def settable(self) -> tuple[str, ...]:
        """The names of predicates that code sets, and no channel or sensor whose values grow old does."""
        grounded = {name for name, _, _ in self._groundings} | self.declared.aged
        return tuple(name for name in self._sensors if name not in grounded)

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Build the network, ground it, and make its first values known."""
        self.sensed = self.channel("sensed", SensorUpdate)
        self.sensed.input = self.sensed.stamped = True
        self.sensed.supersedes = _subject
        self.sensed.merge = _merge
        self.updates = self.channel("updates", PredicateUpdate)
        self.events = self.channel("events", EventUpdate)
        self.map = self.channel("map", PredicateMap)
        self._batches.dispatcher = self.runtime.dispatcher
        self._take_in()
        now = self.runtime.now()
        self._begun = self._home is self.runtime
        if not self._begun:
            self._forget_numbers()
        self._home = self.runtime
        choices, backlog = self.runtime.dispatcher.choices, self._backlog
        backlog.values, backlog.times = choices.kept(self.path, backlog.values, backlog.times, now)
        if backlog.values:
            self.runtime.observers.tell(Kept, now, self.path, dict(backlog.values), dict(backlog.times))
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
        declared = self.declared.names
        self.action_ends.clear()
        self.action_ends.update(name for name in ends if name not in declared or self.declared.raises(name))
        self._raised |= self.action_ends
        self._counter = self._event_counter = 0
        self._age_timers.clear()
        self._first_events = EventUpdate(now, 0, first.events) if first.events else None
        self.map.retain_by(lambda: PredicateMap(self.runtime.now(), self._counter, self.values()))
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
        # Where a run is repeated, its record has what these functions said.
        for name, place, when in () if choices.repeats else self._groundings:
            channel = self.runtime.channel(*place) if isinstance(place, tuple) else place
            self.subscribe(channel, self._grounding(name, when))
        for agent, updates, full in self._followed:
            follower = Follower(self, agent, full)
            self.subscribe(updates, follower.update)
            follower.synchronise()

    def _forget_numbers(self) -> None:
        """Reset thresholds: they know nothing of an earlier runtime."""
        for sensor in self._sensors.values():
            if isinstance(sensor, NumberSensor):
                sensor.begin(self._backlog.values)

    def on_failing(self, error: BaseException) -> None:
        """Let every predicate be unknown at once; sensors' reports from now on are kept for the next start."""
        self.keep()
        known = tuple(name for name, value in self.values().items() if value is not None)
        self._lost = True
        if known:
            self._counter += 1
            self.updates.publish(PredicateUpdate(self.runtime.now(), self._counter, (), (), known))

    def on_stop(self) -> None:
        """Keep sensors' reports from now on for the next start."""
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
                    self._seen[name] = update.time if update.sensed is None else update.sensed
                    if value is not None and name not in self._age_timers:
                        self._watch(name)
        if change is None:
            return
        topics: Topics | None = change.noted
        if topics is None or self.map.heard:
            self._publish(update.time, change)
        elif change.events:  # hot path: events alone, as often before
            self._event_counter = counter = self._event_counter + 1
            self.events.emit_last_on(EventUpdate(update.time, counter, change.events), topics)
        else:  # hot path: predicates alone have changed, as often before
            self._counter = counter = self._counter + 1
            message = PredicateUpdate(update.time, counter, change.rising, change.falling, change.unknown)
            self.updates.emit_last_on(message, topics)

    def _fresh(self, update: SensorUpdate) -> tuple[tuple[str, bool | None], ...]:
        """Return the values of an update, unknown where they waited for longer than they hold."""
        if update.sensed is None:
            return update.predicates
        age = update.time - update.sensed
        limits = self._max_age
        stale = [name for name, value in update.predicates if value is not None and age > limits.get(name, age)]
        if not stale:
            return update.predicates
        self.report("stale", f"values of {', '.join(stale)} waited {age / 1e9:.3g} s, longer than they hold")
        return tuple((name, None if name in stale else value) for name, value in update.predicates)

    def _publish(self, time: int, change: Change) -> None:
        """Publish a change of predicates, of holds, and events; a recurring change is quicker from now on."""
        for name in change.disarmed:
            timer = self._hold_timers.pop(name, None)
            if timer is not None:
                timer.cancel()
        for name in change.armed:
            self._arm(name, time)
        rising, falling, unknown, events = change.rising, change.falling, change.unknown, change.events
        moved = Topics(*rising, *falling, *unknown)
        if moved.names:
            self._counter = counter = self._counter + 1
            self.updates.emit_on(PredicateUpdate(time, counter, rising, falling, unknown), moved)
            if self.map.heard:
                self.map.publish(PredicateMap(time, counter, self._network.values()))
        raised = Topics(*events)
        if events:
            self._event_counter = counter = self._event_counter + 1
            self.events.emit_on(EventUpdate(time, counter, events), raised)
        if not (change.armed or change.disarmed or (events and moved.names)):
            change.noted = raised if events else moved

    @property
    def holding(self) -> Mapping[str, int]:
        """When each predicate with a true formula that must hold for longer becomes true; in nanoseconds."""
        return {name: timer.when for name, timer in self._hold_timers.items()}

    def _arm(self, name: str, since: int) -> None:
        def held() -> None:
            del self._hold_timers[name]
            when = self.runtime.now()
            change = self._network.update((), (), (name,))
            if change:
                self._publish(when, change)

        self._hold_timers[name] = self.call_at(since + self._held_for[name], held)
        for hear in [*self.hears_holds]:
            hear(name)

    def _watch(self, name: str) -> None:
        """Wait until a sensor's value is too old; the timer is moved on lazily, not at each refresh."""
        max_age = self._max_age[name]

        def look() -> None:
            now = self.runtime.now()
            if self._seen[name] + max_age > now:
                self._age_timers[name] = self.call_at(self._seen[name] + max_age, look)
                return
            del self._age_timers[name]
            change = self._network.update(((name, None),))
            if change:
                self.report("stale", f"predicate {name!r} was not refreshed for {max_age / 1e9:g} s", time=now)
                self._publish(now, change)

        self._age_timers[name] = self.call_at(self._seen[name] + max_age, look)

    def _grounding(self, name: str, when: Callable[[Any], Truth]) -> Callable[[Any], None]:
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
    """Return the predicates of an update, by which a newer one supersedes it; None if events must keep their order."""
    return None if update.events else tuple(name for name, _ in update.predicates)


def _merge(older: SensorUpdate, newer: SensorUpdate) -> SensorUpdate:
    """Return the latest values of two updates without events; they are as old as the older one."""
    return SensorUpdate(older.time, tuple({**dict(older.predicates), **dict(newer.predicates)}.items()))


def _tree(formula: Formula | str) -> Formula:
    return parse(formula) if isinstance(formula, str) else formula
