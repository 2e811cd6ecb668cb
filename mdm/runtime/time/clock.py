"""Clocks: where all time and all timers come from.

A clock tells integer nanoseconds and calls back at a given one. `WallClock` is real time; the virtual one lives in
`mdm.runtime.time.virtual`. On CPython 3.11 the event loop's own timers are late by up to a millisecond and more, since
its selector rounds a timeout up to whole milliseconds; on Linux the wall clock therefore waits on a ``timerfd``, which
an event loop can wait for as for a file and which is exact to microseconds. The standard library has it from Python
3.13 on; before that it is reached through the C library. See timerfd_create(2).
"""

from __future__ import annotations

import asyncio
import ctypes
import heapq
import os
import sys
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from itertools import count
from time import monotonic_ns
from typing import TYPE_CHECKING
from weakref import WeakSet

from mdm.checks import is_number
from mdm.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable


def steady(offset: int) -> tuple[Callable[[], int], Callable[[int], None]]:
    """Return a function that tells the steady time, and so many nanoseconds more; and one that adds to these."""
    read = monotonic_ns

    def add(nanoseconds: int) -> None:
        nonlocal offset
        offset += nanoseconds

    return lambda: read() + offset, add


def suspended() -> int:
    """Return for how many nanoseconds the machine has been suspended since it began, while the steady clock stood."""
    since = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    return time.clock_gettime_ns(since) - monotonic_ns()


_ABSOLUTE, _CANCEL_ON_SET = 1, 2
_FAR = 10**18 * 8


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _TimeSpec), ("value", _TimeSpec))


def _library() -> ctypes.CDLL | None:
    if sys.platform != "linux":
        return None
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "timerfd_create"):
        return None
    library.timerfd_settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_TimerSpec), ctypes.c_void_p)
    return library


_LIBRARY = _library()
available = _LIBRARY is not None


def create(clock: int = time.CLOCK_MONOTONIC) -> int:
    """Return the descriptor of a new, non-blocking timer, by default on the steady clock.

    Raises:
        OSError: If the process has no descriptors left, or the platform has no such timers.
    """
    descriptor = -1 if _LIBRARY is None else _LIBRARY.timerfd_create(clock, os.O_NONBLOCK | os.O_CLOEXEC)
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create failed")
    return int(descriptor)


def set_time(descriptor: int, when: int, flags: int = _ABSOLUTE) -> None:
    """Fire once when the timer's clock shows ``when`` nanoseconds (at once if that has passed)."""
    seconds, nanoseconds = divmod(max(when, 1), 1_000_000_000)
    spec = _TimerSpec(_TimeSpec(0, 0), _TimeSpec(seconds, nanoseconds))
    if _LIBRARY is None or _LIBRARY.timerfd_settime(descriptor, flags, ctypes.byref(spec), None) < 0:
        raise OSError(ctypes.get_errno(), "timerfd_settime failed")


def acknowledge(descriptor: int) -> bool:
    """Return whether the timer has fired since it was last asked."""
    try:
        os.read(descriptor, 8)
    except BlockingIOError:
        return False
    return True


def close(descriptor: int) -> None:
    """Give the descriptor back."""
    os.close(descriptor)


_SWEEP = 1024

_MOST = 10_000
_NEVER = sys.maxsize

_SHORTEST_LEAP = 100_000_000

_STEP = 4_000
_LONGEST_LEAD = 400_000


def check_seconds(seconds: object, what: str, *, key: str | None = None) -> None:
    """Refuse a value that is no length of time.

    Raises:
        ConfigError: If it is no number above 0, or above 10^9 (which are 31 years).
    """
    if not is_number(seconds) or not 0 < seconds <= 1e9:
        raise ConfigError(f"{what} is a number of seconds above 0 and at most 10^9, not {seconds!r}", key=key)


class Timer:
    """A callback that waits for its time; ``cancel()`` takes it back."""

    __slots__ = ("__weakref__", "_callback", "when")

    def __init__(self, when: int, callback: Callable[[], None]) -> None:
        self.when = when
        self._callback: Callable[[], None] | None = callback

    @property
    def waiting(self) -> bool:
        """Whether it will still call."""
        return self._callback is not None

    def cancel(self) -> None:
        """Never call."""
        self._callback = None

    def fire(self) -> None:
        """Call, once."""
        callback, self._callback = self._callback, None
        if callback is not None:
            callback()


class Clock(ABC):
    """Tells the time in integer nanoseconds, and calls back at a time.

    A clock serves one runtime at a time. Timers fire in the order of their times; those of the same instant in that of
    their ``rank``, then of their making: input has rank 0 and fixed-rate ticks rank 1, so that a tick sees all input of
    its instant.

    Attributes:
        due: When the next timer is due, or earlier, where that one was cancelled.
        firing: When the timer was due that fires now; -1 between timers.
        resumed: Called with the seconds for which the machine was suspended, when it goes on.
    """

    def __init__(self) -> None:
        self.due = _NEVER
        self.firing = -1
        self._heap: list[tuple[int, int, int, Timer]] = []
        self._order = count()
        self._sweep_at = _SWEEP
        self._firing = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self.resumed: Callable[[float], object] = lambda _: None

    @abstractmethod
    def now(self) -> int:
        """Return the time in nanoseconds since the clock's epoch; callable from any thread."""

    def reader(self) -> Callable[[], int]:
        """Return a function that tells the time as `now` does; hot paths keep it."""
        return self.now

    def corrected(self) -> int:
        """Return by how many nanoseconds the time of day has moved against this clock since the clock began."""
        return 0

    def catch_up(self) -> None:
        """Leap to the time of day where that is ahead, as where the event loop was held until now."""
        return

    def time(self) -> float:
        """Return the time in seconds."""
        return self.now() / 1e9

    def call_at(self, when: int, callback: Callable[[], None], *, rank: int = 0) -> Timer:
        """Call back when the clock shows ``when`` nanoseconds, never earlier."""
        timer = Timer(when, callback)
        if len(self._heap) >= self._sweep_at:  # timers taken back long before their time must not pile up
            self._heap[:] = [entry for entry in self._heap if entry[3].waiting]
            heapq.heapify(self._heap)
            self._sweep_at = max(_SWEEP, 2 * len(self._heap))
        heapq.heappush(self._heap, (when, rank, next(self._order), timer))
        if when < self.due:
            if self._firing:  # what fires looks at it next
                self.due = when
            else:
                self._arm_next()
        return timer

    async def sleep(self, seconds: float, *, rank: int = 0) -> None:
        """Wait by this clock; see `call_at` for the rank."""
        woken = asyncio.get_running_loop().create_future()

        def wake() -> None:
            if not woken.done():
                woken.set_result(None)

        timer = self.call_at(self.now() + round(seconds * 1e9), wake, rank=rank)
        try:
            await woken
        finally:
            timer.cancel()

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Serve timers on this event loop."""
        if self._loop is not None:
            raise RuntimeError("this clock already serves a runtime; give each runtime a clock of its own")
        self._loop = loop

    def close(self) -> None:
        """Forget all timers."""
        self._heap.clear()
        self.due = _NEVER
        self._loop = None

    @abstractmethod
    def _arm(self, when: int) -> None:
        """Have `_fire_due` called at ``when``, in place of any earlier request."""

    def _arm_next(self) -> None:
        self._look_at_next()
        if self.due != _NEVER and self._loop is not None:
            self._arm(self.due)

    def _look_at_next(self) -> None:
        heap = self._heap
        while heap and not heap[0][3].waiting:
            heapq.heappop(heap)
        self.due = heap[0][0] if heap else _NEVER

    def _next_rank(self) -> int:
        """Return the rank of the next timer."""
        return self._heap[0][1] if self._heap else 0

    def fire_before(self, when: int) -> None:
        """Fire the timers that come before a stimulus of that time: all due ones but ticks of its own instant."""
        self._fire(when, when)

    def fire_first(self) -> None:
        """Fire the timer that is due first, and no other."""
        when, _, _, timer = heapq.heappop(self._heap)
        self._call(when, timer)

    def _call(self, when: int, timer: Timer) -> None:
        before, self.firing = self.firing, when
        try:
            timer.fire()
        finally:
            self.firing = before

    def _fire_due(self) -> None:
        now = self.now()
        self._fire(now, now + 1, one_rank=True)

    def _fire(self, by: int, before: int, *, one_rank: bool = False) -> None:
        """Fire timers of rank 0 that are due by a time, and those of other ranks that are due before one.

        One by one, for a timer may set another that comes before the next. A bounded number: one that sets itself for
        the present must not starve the event loop.

        Args:
            by: The one time, in nanoseconds.
            before: The other.
            one_rank: Leave timers of a further rank of an instant to the next call, when tasks that those before have
                resumed have run.
        """
        heap, left, nested, due = self._heap, _MOST, self._firing, self.due
        fired = (-1, 0)
        self._firing = True
        try:
            while heap and left:
                when, rank, _, timer = heap[0]
                if when > by or (rank and (when >= before or (one_rank and fired[0] == when and fired[1] < rank))):
                    break
                heapq.heappop(heap)
                if timer.waiting:
                    left -= 1
                    fired = (when, rank)
                    self._call(when, timer)
        finally:
            self._firing = nested
            self._look_at_next()
            if not nested and (by < before or self.due != due):  # else the request to be called is as it was
                self._arm_next()


class WallClock(Clock):
    """Real time: nanoseconds since 1970, steady.

    The offset between the steady clock and the time of day is taken once, so that a correction of the time of day
    never makes it jump; processes on one machine, and machines whose time of day is synchronised, agree on it to
    within that synchronisation, so that replicas tick together. When a suspended machine goes on, the clock leaps by
    the time for which it was.

    An idle machine takes some 100 to 400 µs to wake a program. The clock learns how long this one takes, asks to be
    woken that much earlier, and spins for the rest, which is seldom more than 100 µs: 1 % of a core at 100 Hz.

    Args:
        spin: Wake early and spin; without it, timers come as late as the machine wakes.
    """

    def __init__(self, *, spin: bool = True) -> None:
        super().__init__()
        self._spin = spin
        self._lead = 100_000 if spin else 0
        self._woken_for = 0
        self._learning = False
        self._offset = offset = time.time_ns() - time.monotonic_ns()
        # One for all: what many ensembles share stays in the processor's cache.
        self._reader, self._add = steady(offset)
        self._suspended = suspended()
        _walls.add(self)
        self._descriptor: int | None = None
        self._resumes: int | None = None
        self._handle: asyncio.TimerHandle | None = None

    def now(self) -> int:
        """Return nanoseconds since 1970."""
        return monotonic_ns() + self._offset

    def corrected(self) -> int:
        """Return by how many nanoseconds the time of day was put right since the clock began."""
        return time.time_ns() - self.now()

    def catch_up(self) -> None:
        """Leap to the time of day where that is ahead, and the process's wall clocks with it that serve no runtime."""
        self._leap(WallClock.corrected)

    def _resume(self) -> None:
        """Leap where the machine was suspended, so that old values expire before the next input counts."""
        assert self._resumes is not None
        with suppress(OSError):  # which says that the machine was suspended, or its time set
            os.read(self._resumes, 8)
        total = suspended()
        slept = total - self._suspended
        self._leap(lambda clock: total - clock._suspended)  # noqa: SLF001 - one class
        if slept > _SHORTEST_LEAP:
            self.resumed(slept / 1e9)

    def _leap(self, far: Callable[[WallClock], int]) -> None:
        for clock in tuple(_walls):
            if (clock is self or clock._loop is None) and (leap := far(clock)) > _SHORTEST_LEAP:  # noqa: SLF001
                clock._offset += leap  # noqa: SLF001
                clock._add(leap)  # noqa: SLF001
                clock._suspended = suspended()  # noqa: SLF001
        self._arm_next()

    def reader(self) -> Callable[[], int]:
        """Return a function that does as `now`, at two thirds of its cost."""
        return self._reader

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Serve timers on this event loop, through a ``timerfd`` where the platform has one."""
        super().open(loop)
        if available:
            self._descriptor = create()
            self._resumes = create(time.CLOCK_REALTIME)
            set_time(self._resumes, _FAR, _ABSOLUTE | _CANCEL_ON_SET)
            try:
                loop.add_reader(self._descriptor, self._timerfd_fired)
                loop.add_reader(self._resumes, self._resume)
            except NotImplementedError:
                self._give_back()
        self._arm_next()

    def close(self) -> None:
        """Forget all timers and give the timer device back."""
        self._give_back()
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        super().close()

    def _give_back(self) -> None:
        for descriptor in (self._descriptor, self._resumes):
            if descriptor is not None:
                if self._loop is not None and not self._loop.is_closed():
                    with suppress(NotImplementedError):
                        self._loop.remove_reader(descriptor)
                close(descriptor)
        self._descriptor = self._resumes = None

    def _arm(self, when: int) -> None:
        steady = when - self._offset
        if self._descriptor is not None:
            self._woken_for = steady - self._lead
            self._learning = self._spin and self._woken_for > monotonic_ns()
            set_time(self._descriptor, self._woken_for)
        elif self._loop is not None:
            if self._handle is not None:
                self._handle.cancel()
            delay = (steady - time.monotonic_ns()) / 1e9
            self._handle = self._loop.call_later(max(delay, 0.0), self._fire_due)

    def _timerfd_fired(self) -> None:
        if self._descriptor is None or not acknowledge(self._descriptor):
            return
        now = monotonic_ns()
        if self._learning:
            # Small steps, two up for one that is twice as long down, lead to the time that two wakes in three exceed.
            late = now - self._woken_for > self._lead
            self._lead = min(self._lead + _STEP, _LONGEST_LEAD) if late else max(self._lead - 2 * _STEP, 0)
        if self.due != _NEVER:
            due = self.due - self._offset
            while monotonic_ns() < due:
                pass
        self._fire_due()


_walls: WeakSet[WallClock] = WeakSet()
