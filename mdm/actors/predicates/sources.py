"""Where the values of predicates come from: sensors, alone or in batches, and other agents' predicates."""

from __future__ import annotations

import sys
from asyncio import _get_running_loop
from numbers import Real
from threading import get_ident
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from mdm.actors.predicates.predicate_manager import PredicateManager
    from mdm.checks import Number
    from mdm.logic import Threshold
    from mdm.messages import PredicateMap, PredicateUpdate
    from mdm.runtime import Channel, Subscription
    from mdm.runtime.dispatcher import Dispatcher

Readings = tuple[tuple[str, "bool | None"]]
"""The name of a predicate and its value, as the only ones of an update."""


def truth(name: str, value: object) -> bool | None:
    """Return the value of a predicate.

    Raises:
        Error: If it is no truth value: True, False, one of numpy's, or None for unknown.
    """
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    hint = "; a number needs a threshold, as in when = '< 0.2 until > 0.3'" if isinstance(value, Real) else ""
    raise Error(f"predicate {name!r} is True, False or None (unknown), not {value!r}{hint}")


class Sensor:
    """Sets one predicate, from anywhere: a callback, a task, another thread.

    Args:
        name: The predicate.
        manager: Its predicate manager.
    """

    __slots__ = ("_false", "_manager", "_true", "name")

    def __init__(self, name: str, manager: PredicateManager) -> None:
        self.name = name
        self._manager = manager
        self._true: Readings = ((name, True),)
        self._false: Readings = ((name, False),)

    def set(self, value: bool | np.bool_ | Number | None) -> None:
        """Say whether the predicate holds, or of one with a threshold the number; None says that it is unknown.

        In the event loop all that follows has happened when this returns, up to the first line of an action's callback.
        In another thread this wakes the event loop, where it follows, and returns at once. After the runtime's end
        nothing follows, and it is counted.

        Raises:
            Error: If the value is no truth value.
        """
        if value is True:
            readings = self._true
        elif value is False:
            readings = self._false
        else:
            readings = ((self.name, self.truth(value)),)
        self._manager.take(readings)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r}: {self.value}>"

    def truth(self, value: object) -> bool | None:
        """Return the value of the predicate that is told by this one.

        Raises:
            Error: If it tells none.
        """
        return truth(self.name, value)

    @property
    def value(self) -> bool | None:
        """The predicate's present value."""
        return self._manager.value(self.name)


class NumberSensor(Sensor):
    """Sets one predicate by numbers, from anywhere: whether a threshold holds.

    Between its two bounds a number leaves the predicate as it was last known, and at the start unknown. NaN and None
    are unknown; a truth value is taken as it is.

    Args:
        name: The predicate.
        manager: Its predicate manager.
        threshold: When it holds.
        initial: Its value at the start.
    """

    __slots__ = ("_before", "_initial", "_threshold")

    def __init__(self, name: str, manager: PredicateManager, threshold: Threshold, initial: bool | None) -> None:
        super().__init__(name, manager)
        self._threshold = threshold
        self._initial = self._before = initial

    def begin(self, told: Mapping[str, bool | None]) -> None:
        """Forget all that was known but what has been told for the first start."""
        known = told.get(self.name)
        self._before = self._initial if known is None else known

    def set(self, value: bool | np.bool_ | Number | None) -> None:
        """Tell the number, as `Sensor.set` does a truth value."""
        self._manager.take(((self.name, self.truth(value)),))

    def truth(self, value: object) -> bool | None:
        """Return whether the threshold holds for a number."""
        if value is None or isinstance(value, bool | np.bool_):
            told = truth(self.name, value)
        elif isinstance(value, Real):
            told = self._threshold.of(value, self._before)  # type: ignore[arg-type]  # which is compared alone
        else:
            raise Error(f"predicate {self.name!r} is told numbers ({self._threshold}), not {value!r}")
        if told is not None:
            self._before = told
        return told


class EventSource:
    """Raises one event, from anywhere.

    Args:
        name: The event.
        manager: Its predicate manager.
    """

    __slots__ = ("_manager", "name")

    def __init__(self, name: str, manager: PredicateManager) -> None:
        self.name = name
        self._manager = manager

    def fire(self) -> None:
        """Say that the event has just occurred."""
        self._manager.occur(self.name)


class Backlog:
    """The last value that each sensor was told before a start, or since the failure that leads to one.

    Attributes:
        values: By predicate.
        times: When they were told, in nanoseconds, where that is known.
    """

    __slots__ = ("times", "values")

    def __init__(self) -> None:
        self.values: dict[str, bool | None] = {}
        self.times: dict[str, int] = {}

    def put(self, readings: Iterable[tuple[str, bool | None]], time: int | None) -> None:
        """Take values, told at a time in nanoseconds; None before the first start, when there is no clock."""
        for name, value in readings:
            self.values[name] = value
            if time is not None:
                self.times[name] = time

    def expire(self, now: int, limits: Mapping[str, int]) -> None:
        """Let values expire that are older than their limits, in nanoseconds."""
        for name, limit in limits.items():
            if now - self.times.get(name, now) > limit:
                self.values.pop(name, None)

    def told(self, name: str, now: int) -> int:
        """Return when a sensor was told its value; now, where that is not known."""
        return self.times.get(name, now)

    def clear(self) -> None:
        """Forget everything."""
        self.values.clear()
        self.times.clear()


if sys.version_info >= (3, 12):
    from asyncio import current_task
else:  # there `asyncio.current_task` is plain Python around a look-up, and takes three times as long as that
    from asyncio.tasks import _current_tasks  # type: ignore[attr-defined]

    current_task = _current_tasks.get

Value = tuple[str, "bool | None"]


class Batches:
    """The open batches of a predicate manager: one a task, or outside of tasks one a thread.

    Args:
        tell: Receives a batch's reports, at its end.

    Attributes:
        dispatcher: The predicate manager's, once that has been started.
        open: By task or thread.
    """

    __slots__ = ("dispatcher", "open", "tell")

    def __init__(self, tell: Callable[[tuple[Value, ...], tuple[str, ...]], object]) -> None:
        self.tell = tell
        self.dispatcher: Dispatcher | None = None
        self.open: dict[object, Batch] = {}

    def scope(self) -> object:
        """Return the running asyncio task, or else the thread.

        Hot path: which loop runs takes a system call to find out, and a dispatcher's own thread runs its loop.
        """
        thread, dispatcher = get_ident(), self.dispatcher
        if dispatcher is not None and dispatcher.thread == thread and dispatcher.loop is not None:
            return current_task(dispatcher.loop) or thread
        loop = _get_running_loop()  # None where none runs, in place of an exception
        return thread if loop is None else current_task(loop) or thread


class Batch:
    """A block in which values of predicates, the latest of each, and events, in their order, are gathered.

    Within another batch of the same task or thread it leaves all to that one.

    Args:
        batches: The predicate manager's open ones.

    Attributes:
        readings: Predicates with their values, by name.
        events: Their names.
    """

    __slots__ = ("_batches", "_scope", "events", "readings")

    def __init__(self, batches: Batches) -> None:
        self._batches = batches
        self._scope: object = None

    def __enter__(self) -> None:
        """Gather the reports of the present task or thread from now on."""
        found = self._batches.scope()
        if self._batches.open.setdefault(found, self) is self:
            self._scope = found
            self.readings: dict[str, Value] = {}
            self.events: tuple[str, ...] = ()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Send the gathered reports, from any caller and also after an exception.

        Hot path: CPython calls a function with named arguments at once, such as the one in `tell`.
        """
        if self._scope is None:
            return
        batches = self._batches
        del batches.open[self._scope]
        self._scope = None
        if self.readings or self.events:
            tell = batches.tell
            tell(tuple(self.readings.values()), self.events)


class Follower:
    """Keeps another agent's predicates up to date in a predicate manager.

    Args:
        manager: Where they are known as ``agent/Name``.
        agent: The other agent.
        full: The other's map, read at first, and again when a counter shows that an update was lost.
    """

    def __init__(self, manager: PredicateManager, agent: str, full: Channel[PredicateMap]) -> None:
        self._manager = manager
        self._agent = agent
        self._full = full
        self._subscription: Subscription[PredicateMap] | None = None
        self._counter = -1

    def synchronise(self) -> None:
        """Read the other's whole map, once."""
        if self._subscription is None:
            self._subscription = self._manager.subscribe(self._full, self._map)

    def _map(self, message: PredicateMap) -> None:
        if self._subscription is not None:
            self._subscription.cancel()
            self._subscription = None
        self._counter = message.counter
        self._take(message.values.items())

    def update(self, update: PredicateUpdate) -> None:
        """Apply the other agent's changes."""
        if update.counter != self._counter + 1:
            self.synchronise()
        self._counter = update.counter
        changes = [(name, True) for name in update.rising]
        changes += [(name, False) for name in update.falling]
        self._take([*changes, *((name, None) for name in update.unknown)])

    def _take(self, values: Iterable[tuple[str, bool | None]]) -> None:
        known = self._manager.known
        changes = tuple((f"{self._agent}/{name}", value) for name, value in values if f"{self._agent}/{name}" in known)
        if changes:
            self._manager.derive(changes)
