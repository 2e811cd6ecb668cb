"""Virtual time: runs without waiting, deterministically.

Time advances only when nothing is left to do, straight to the next timer. The event loop's own time is virtual with
the clock's, so that ``asyncio.sleep``, ``anyio.sleep`` and timeouts obey it too.
"""

from __future__ import annotations

import asyncio
import selectors
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple

from mdm.errors import Error
from mdm.runtime.dispatcher import LOOK_EVERY
from mdm.runtime.time.clock import Clock

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from concurrent.futures import Executor

    from _typeshed import FileDescriptorLike

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")

_STEP = 10_000_000
"""Nanoseconds that pass in each round once time must go on."""
_ROUNDS = 1000
"""Rounds of the event loop after which ticks wait no longer for tasks of their instant, one of which may never rest."""


class DeadlockError(Error):
    """Virtual time cannot go on: no timer is set, no input can come, and the program still waits."""


class _VirtualSelector(selectors.BaseSelector):
    """Looks at real input without waiting, and moves the time to the next timer where there is none."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self.now = 0
        self.awaited = 0
        self.workers: set[threading.Thread] = set()
        self.settled: list[Callable[[], object]] = []
        self._rounds = 0
        # Called once in `LOOK_EVERY` rounds of all.
        self.looks: list[Callable[[], object]] = []
        self._all_rounds = 0
        self.step = 0

    def answered(self, _: object) -> None:
        """Wait for one thread less."""
        self.awaited -= 1

    def register(self, fileobj: FileDescriptorLike, events: int, data: object = None) -> selectors.SelectorKey:
        return self._selector.register(fileobj, events, data)

    def unregister(self, fileobj: FileDescriptorLike) -> selectors.SelectorKey:
        return self._selector.unregister(fileobj)

    def modify(self, fileobj: FileDescriptorLike, events: int, data: object = None) -> selectors.SelectorKey:
        return self._selector.modify(fileobj, events, data)

    def get_map(self) -> Mapping[FileDescriptorLike, selectors.SelectorKey]:
        return self._selector.get_map()

    def close(self) -> None:
        self._selector.close()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._all_rounds += 1
        self.now += self.step
        if not self._all_rounds % LOOK_EVERY:
            for look in self.looks:
                look()
        ready = self._selector.select(0)
        is_busy = bool(ready) or (timeout is not None and timeout <= 0)
        if self.settled:
            self._rounds += 1
            if not is_busy or self._rounds > _ROUNDS:
                settled, self.settled, self._rounds = self.settled, [], 0
                for callback in settled:
                    callback()
                return ready
        if is_busy:
            return ready
        if self.awaited:
            return self._selector.select(None)
        if timeout is not None:
            self.now += max(1, round(timeout * 1e9))
            return ready
        # The loop's own wake-up pipe is always registered; more than that, or another thread, can still bring input.
        others = [thread for thread in threading.enumerate() if thread not in self.workers]
        if len(self._selector.get_map()) <= 1 and len(others) == 1:
            raise DeadlockError(
                "virtual time stands still: everything waits, no timer is set, and no file or thread can bring input"
            )
        return self._selector.select(None)


class VirtualEventLoop(asyncio.SelectorEventLoop):
    """An asyncio event loop whose time is virtual: it starts at 0 and jumps from timer to timer.

    While ``run_in_executor`` or ``asyncio.to_thread`` has a thread at work, something is left to do, and time stands
    still. Of threads that a program starts in other ways the loop knows nothing: time goes on beside them.
    """

    def __init__(self) -> None:
        self._virtual = _VirtualSelector()
        super().__init__(self._virtual)
        self._has_executor = False
        # asyncio treats timers within its clock's resolution as due; virtual time is exact to the nanosecond.
        self._clock_resolution = 1e-9

    @property
    def looks(self) -> list[Callable[[], object]]:
        """Functions that are called once in `LOOK_EVERY` rounds, whether time goes on or not."""
        return self._virtual.looks

    def go_on(self) -> None:
        """Let time pass though something is left to do: work beside a circle waits for timers, too."""
        self._virtual.step = _STEP

    def time(self) -> float:
        """Return virtual seconds."""
        return self._virtual.now / 1e9

    def time_ns(self) -> int:
        """Return virtual nanoseconds."""
        return self._virtual.now

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[*Arguments], T], *args: *Arguments
    ) -> asyncio.Future[T]:
        """Run a function in a thread; time stands still until it returns."""
        virtual = self._virtual
        if executor is None and not self._has_executor:
            # Its threads stay when they have nothing to do, and must then not be taken for ones that bring input.
            self._has_executor = True
            self.set_default_executor(
                ThreadPoolExecutor(initializer=lambda: virtual.workers.add(threading.current_thread()))
            )
        job = super().run_in_executor(executor, func, *args)
        virtual.awaited += 1
        job.add_done_callback(virtual.answered)
        return job

    def call_settled(self, callback: Callable[[], object]) -> None:
        """Call back, once, when no task has anything left to do at this instant, and before time moves on."""
        self._virtual.settled.append(lambda: self.call_soon(callback))

    async def shutdown_default_executor(self, *args: Any) -> None:
        """Wait for the threads, during which time stands still."""
        self._virtual.awaited += 1
        try:
            await super().shutdown_default_executor(*args)
        finally:
            self._virtual.awaited -= 1


class VirtualClock(Clock):
    """A clock in virtual time; its event loop must be a `VirtualEventLoop`.

    Args:
        epoch: The time in nanoseconds that it shows at the start of its event loop, such as that at which a record
            begins: ticks are aligned to multiples of their period from 0 on all the same.
    """

    def __init__(self, *, epoch: int = 0) -> None:
        super().__init__()
        if not isinstance(epoch, int) or isinstance(epoch, bool) or epoch < 0:
            raise Error(f"an epoch is a whole number of nanoseconds from 0 on, not {epoch!r}")
        self.epoch = epoch
        self._handle: asyncio.TimerHandle | None = None

    def now(self) -> int:
        """Return the nanoseconds since the event loop began, and the epoch."""
        return self.epoch + self._loop.time_ns() if isinstance(self._loop, VirtualEventLoop) else self.epoch

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Serve timers on this virtual event loop.

        Raises:
            Error: If the event loop's time is real.
        """
        if not isinstance(loop, VirtualEventLoop):
            raise Error(
                "a VirtualClock needs an event loop whose time is virtual: start the program with "
                "mdm.run(main, virtual=True), or with asyncio.Runner(loop_factory=mdm.VirtualEventLoop)"
            )
        super().open(loop)
        self._arm_next()

    def close(self) -> None:
        """Forget all timers."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        super().close()

    def _arm(self, when: int) -> None:
        if self._handle is not None:
            self._handle.cancel()
        if self._loop is not None:
            # Seconds since the event loop began: those since 1970 have steps of 238 ns in floating point.
            self._handle = self._loop.call_at((when - self.epoch) / 1e9, self._fire_when, when)

    def _fire_when(self, when: int) -> None:
        loop = self._loop
        if not isinstance(loop, VirtualEventLoop):
            return
        if self.now() < when:
            # Seconds in floating point may be a nanosecond short of the due time.
            self._handle = loop.call_at((when - self.epoch + 1) / 1e9, self._fire_when, when)
        elif self._next_rank() > 0:
            # Tasks that slept until this instant shall have their say before its ticks, and so shall what they resume.
            # How many rounds of the loop that takes differs between versions of Python: `asyncio.wait_for` takes five
            # on 3.11, and two since.
            self._handle = None
            loop.call_settled(self._fire_due_if_open)
        else:
            self._fire_due()

    def _fire_due_if_open(self) -> None:
        if self._loop is not None:
            self._fire_due()
