"""The watchdog, a thread that checks that the event loop turns, and the emergency: the program's own last resort.

The watchdog asks the loop, some twenty times a second, to call back. Without an answer it acts without the loop: it
finds the stack of the loop's thread, writes to the log, and calls the emergency.
"""

from __future__ import annotations

import inspect
import sys
import threading
import traceback
from contextlib import suppress
from time import monotonic, monotonic_ns
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.runtime.handler import check_plain
from mdm.runtime.statistics import Latencies, LoopStatistics
from mdm.runtime.supervision import describe
from mdm.runtime.time.clock import check_seconds

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable
    from types import FrameType

_PATIENCE = 0.5


class Emergency:
    """Functions that make the robot safe by themselves, each called on a thread of its own.

    No caller waits for them: one that takes long, or never ends, holds neither the event loop nor another one.

    Args:
        report: Takes a fault's detail, on any thread.
        threads: Whether to use threads; where time is virtual, the functions are called at once.
    """

    def __init__(self, report: Callable[[str], object], *, threads: bool) -> None:
        self._report = report
        self._uses_threads = threads
        self._functions: tuple[Callable[[], object], ...] = ()
        self._threads: list[threading.Thread] = []

    def add(self, function: Callable[[], object]) -> None:
        """Call a function, too, once each time, behind those before it."""
        if function not in self._functions:
            self._functions += (function,)

    def call(self, reason: str) -> None:
        """Report why, and call all functions. From any thread."""
        functions = self._functions
        with suppress(Exception):  # be it for want of memory, it keeps no function from being called
            self._report(reason if functions else f"{reason}, and no `emergency` was given to Runtime")
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        for function in functions:
            thread = threading.Thread(target=self._run, args=(function,), name="mdm:emergency", daemon=True)
            try:
                if not self._uses_threads:
                    raise RuntimeError
                thread.start()
            except RuntimeError:  # no thread can be started, or none shall be
                self._run(function)
            else:
                self._threads.append(thread)

    def _run(self, function: Callable[[], object]) -> None:
        try:
            function()
        except BaseException as error:
            self._report(f"`emergency` failed: {describe(error)}")

    def close(self) -> None:
        """Give calls that are under way half a second to end."""
        until = monotonic() + _PATIENCE
        for thread in self._threads:
            thread.join(max(0.0, until - monotonic()))


def check_emergency(emergency: Callable[[], object]) -> None:
    """Refuse an object that cannot be called as an emergency.

    Raises:
        Error: If it is no plain function, or needs arguments.
    """
    check_plain(emergency, "`emergency`")
    with suppress(ValueError):  # of some functions in C no signature is known
        try:
            inspect.signature(emergency).bind()
        except TypeError as error:
            raise Error(f"`emergency` is called without arguments: {error}") from None


_SHORTEST = 0.01
_PAUSE = 0.05
_FRAMES = 20
_PATIENCE = 0.5


class Watchdog:
    """Watches an event loop from a thread of its own.

    Args:
        limit: Seconds without a turn of the loop after which `alarm` is called.
        alarm: Takes the kind and the detail of a fault, on any thread.
        emergency: Takes a reason, on the watchdog's thread, and returns at once.
        emergency_after: Seconds without a turn after which `emergency` is called; None for never.
    """

    def __init__(
        self,
        limit: float,
        alarm: Callable[[str, str], object],
        emergency: Callable[[str], object],
        emergency_after: float | None,
    ) -> None:
        self._limit = limit
        self._alarm = alarm
        self._emergency = emergency
        self._emergency_after = emergency_after
        self._pause = min(_PAUSE, limit / 4)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="mdm:watchdog", daemon=True)
        self._asked: int | None = None
        self._since = self._looked = 0
        self._told = self._called = self._excused = False
        self._stalls = 0
        self._delays = Latencies()

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Watch this event loop, which runs on the calling thread."""
        self._loop = loop
        self._holder = threading.get_ident()
        self._looked = monotonic_ns()
        self._thread.start()

    def call_emergency(self) -> None:
        """Call the emergency from now on; where no time was given, as soon as a stall is told."""
        if self._emergency_after is None:
            self._emergency_after = self._limit

    def close(self) -> None:
        """Watch no more."""
        self._ended.set()
        self._thread.join(_PATIENCE)

    def _watch(self) -> None:
        pause = self._pause
        while not self._ended.wait(pause):
            pause = self._pause
            try:
                pause = self._look(monotonic_ns())
            except Exception:
                # Whatever fails here, be it for want of memory, the next look is as good as this one.
                if self._loop.is_closed():
                    return

    def _look(self, now: int) -> float:
        """Look once whether the loop has turned; return in how many seconds to look again."""
        due, self._looked = self._looked + round(self._pause * 1e9), now
        stopped = now - due > self._limit * 5e8
        if self._asked is None:
            self._since = now
            self._excused = stopped
            self._told = self._called = False
            self._asked = due if stopped else now
            self._loop.call_soon_threadsafe(self._turned, self._asked)
            return self._pause
        if stopped and not self._excused:
            # The whole process stood still. That is counted, but the loop gets time to answer before it is blamed; but
            # once, as native calls that hold the interpreter, one after the other, look the same.
            self._since = now
            self._excused = True
        waited = (now - self._since) / 1e9
        if self._emergency_after is not None and waited >= self._emergency_after and not self._called:
            self._called = True
            self._emergency(f"the event loop has not turned for {self._emergency_after:g} s")
        if waited >= self._limit and not self._told:
            self._told = True
            frame = sys._current_frames().get(self._holder)  # noqa: SLF001 - public by documentation
            place = "nowhere in Python" if frame is None else f"at {_stack(frame)}"
            self._alarm("stall", f"the event loop has not turned for {self._limit:g} s: it is held {place}")
        next_time = self._limit if not self._told else self._emergency_after if not self._called else None
        return self._pause if next_time is None else min(self._pause, max(next_time - waited, 1e-4))

    def _turned(self, asked: int) -> None:
        """Note, on the loop, that it has turned."""
        delay = monotonic_ns() - asked
        self._asked = None
        self._delays.record(delay)
        if delay >= self._limit * 1e9:
            self._stalls += 1
            # In the loop's next round, so that the fault that tells where comes first.
            self._loop.call_soon(self._alarm, "stall", f"the event loop stood still for {delay / 1e9:.3g} s")

    def statistics(self) -> LoopStatistics:
        """Return how the loop has turned so far; call it on the loop's thread."""
        return LoopStatistics(stalls=self._stalls, delays=self._delays.snapshot())


def _stack(frame: FrameType) -> str:
    """Return a stack in words, the innermost call first, without the calls that run the loop.

    Source is read of the frames that are told alone: each file that is opened gives the interpreter up, and who holds
    it may keep it for long.
    """
    frames: list[tuple[FrameType, int]] = []
    for one, line in traceback.walk_stack(frame):
        code = one.f_code
        if len(frames) == _FRAMES or (code.co_name == "_run" and code.co_filename.endswith("asyncio/events.py")):
            break
        frames.append((one, line))
    places = traceback.StackSummary.extract(iter(frames))
    calls = [f"{place.filename}:{place.lineno} in {place.name} ({place.line})" for place in places]
    return ", called from ".join(calls)


def check_watch(watchdog: float | None, emergency: Callable[[], object] | None, emergency_after: float | None) -> None:
    """Refuse limits that cannot be watched, and objects that cannot be called.

    Raises:
        Error: If it cannot.
    """
    if watchdog is not None:
        check_seconds(watchdog, "watchdog")
        if watchdog < _SHORTEST:
            raise Error(f"a watchdog waits {_SHORTEST} s at least, not {watchdog}")
    if emergency is not None:
        check_emergency(emergency)
    if emergency_after is not None:
        check_seconds(emergency_after, "emergency_after")
        if emergency is None or watchdog is None:
            raise Error("emergency_after is the time until the watchdog calls `emergency`: give both")
        if emergency_after < watchdog:
            raise Error(f"emergency_after is {emergency_after} s, before the watchdog's {watchdog} s have passed")
