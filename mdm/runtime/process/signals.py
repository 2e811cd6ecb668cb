"""Signals that ask a program to end: Ctrl-C, ``kill``, a terminal that closes."""

from __future__ import annotations

import asyncio
import atexit
import os
import signal
import socket
import threading
from itertools import count
from time import monotonic
from typing import TYPE_CHECKING, Any

from mdm.runtime.time.virtual import VirtualEventLoop

if TYPE_CHECKING:
    from collections.abc import Callable

_NUMBERS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_MOMENT = 0.25
_LINGER = 1.0


class Signals:
    """Takes SIGINT, SIGTERM and SIGHUP in place of their default handlers, and gives them back.

    The first signal asks the program to leave; others within a quarter of a second after it count as the same, since a
    terminal that closes, and programs that end others, send several. A second one changes nothing while what that takes
    is within its limit; the next breaks it off. Where the event loop is held, and does not hear of the first, the third
    is raised in what holds it. A signal that is ignored stays ignored, and a handler of the program's own stays in
    place.

    Once one was heard, the handlers stay for a second after all has stopped, or to the end of the process: what comes
    then changes nothing, else it would take the place of the first one in the program's status.

    The handlers are Python's (`signal.signal`), which run under every event loop, and where the loop is held.

    Args:
        leave: Called by the event loop with the exception to raise at the end, `KeyboardInterrupt` or `SystemExit` with
            status 128 + n; it returns for how many seconds a second signal changes nothing.
        break_off: Called by the event loop, once, when there is no more waiting.
        last: Hear only signals that no others hear that were opened later and are still open.
    """

    def __init__(
        self, leave: Callable[[BaseException], float], break_off: Callable[[], object], *, last: bool = False
    ) -> None:
        self._leave = leave
        self._break_off = break_off
        self.last = last
        self.loop: asyncio.AbstractEventLoop | None = None
        self._bell: _Bell | None = None
        self._process = 0
        self.previous: dict[int, Any] = {}
        self._numbers = count()
        self._later = 0
        self._first = 0
        self._since = 0.0
        self._exit: BaseException | None = None
        self._until: float | None = None
        self._broken = False
        self._closed_at: float | None = None

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Listen; in the main thread alone, as no other one may."""
        if threading.current_thread() is not threading.main_thread():
            return
        self.loop = loop
        self._process = os.getpid()
        for number in _NUMBERS:
            handler = signal.getsignal(number)
            is_default = handler in {signal.SIG_DFL, signal.default_int_handler} or _of_asyncio(handler)
            if is_default or _signals_of(handler) is not None:
                self.previous[number] = signal.signal(number, self._handle)
        if self.previous and not isinstance(loop, VirtualEventLoop):  # it tells by its files whether input can come
            self._bell = _Bell(loop)

    def close(self) -> None:
        """Listen no more, and give the handlers back; after a signal not before the next one.

        A signal that came too late for the event loop to turn once more goes to the handler of that moment.
        """
        self.loop = None
        if self._bell is not None:
            self._bell.close()
            self._bell = None
        late = self._exit is not None and self._until is None
        if self._until is not None:
            self._closed_at = monotonic()
            atexit.register(self._ignore)
        else:
            self._give_back()
        # Python keeps the handlers, and these must not keep the program that has ended.
        self._exit, self._leave, self._break_off = None, lambda _: 0.0, lambda: None
        if late:
            os.kill(os.getpid(), self._first)

    @property
    def takes(self) -> bool:
        """Whether a signal is taken: it is listened for, or changes nothing any more."""
        return self.loop is not None or (self._closed_at is not None and monotonic() < self._closed_at + _LINGER)

    def _give_back(self) -> None:
        for number, previous in self.previous.items():
            if signal.getsignal(number) == self._handle:
                handler: Any = previous
                while (outer := _signals_of(handler)) is not None and not outer.takes:
                    handler = outer.previous[number]  # it was closed before those inside it
                if _of_asyncio(handler) and handler.keywords["main_task"].done():  # its program has ended
                    handler = signal.default_int_handler
                signal.signal(number, handler)

    def _ignore(self) -> None:
        """Ignore signals at the exit of the interpreter, which gives up Python's handlers before all else."""
        for number in self.previous:
            if signal.getsignal(number) == self._handle and self.takes:
                signal.signal(number, signal.SIG_IGN)

    def _handle(self, number: int, _: object) -> None:
        if os.getpid() != self._process:  # a forked child: its end is its own affair
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        taking: list[Signals] = []
        signals: Signals | None = self
        while signals is not None:
            if signals.takes and not (signals.last and taking):
                taking.append(signals)
            signals = _signals_of(signals.previous.get(number))
        for signals in taking:
            signals.hear(number)
        if not taking:
            self._give_back()
            os.kill(os.getpid(), number)

    def hear(self, number: int) -> None:
        """Take one signal; called by the handler, which another signal may interrupt anywhere."""
        if self.loop is None or self.loop.is_closed():
            return
        if next(self._numbers) == 0:
            self._first, self._since = number, monotonic()
            self._exit = KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)
            self.loop.call_soon_threadsafe(self._begin, self._exit)
            return
        now = monotonic()
        if self._exit is None or now < self._since + _MOMENT:
            return
        self._later += 1
        if self._later == 1 and (self._until is None or now < self._until):
            return
        if self._until is not None and not self._broken:
            self._broken = True
            self.loop.call_soon_threadsafe(self._break_off)
        else:
            self._until = now
            raise self._exit

    def _begin(self, error: BaseException) -> None:
        self._until = monotonic() + self._leave(error)


class _Bell:
    """Wakes an event loop at a signal, for Python's handlers run only where the main thread does.

    It would sleep on where another thread takes the signal, or where it comes just before the loop begins to wait.
    uvloop has such a bell of its own, and so has asyncio once a program asks it for a signal: these stay in place.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._reader, self._writer = socket.socketpair()
        self._reader.setblocking(False)
        self._writer.setblocking(False)
        self._number = self._writer.fileno()
        self._previous = signal.set_wakeup_fd(self._number, warn_on_full_buffer=False)
        if self._previous == -1:
            loop.add_reader(self._reader, self._reader.recv, 4096)
        else:
            signal.set_wakeup_fd(self._previous)

    def close(self) -> None:
        self._loop.remove_reader(self._reader)
        if (now := signal.set_wakeup_fd(-1)) != self._number:
            signal.set_wakeup_fd(now)
        self._reader.close()
        self._writer.close()


def _signals_of(handler: object) -> Signals | None:
    owner = getattr(handler, "__self__", None)
    return owner if isinstance(owner, Signals) else None


def _of_asyncio(handler: object) -> bool:
    return isinstance(getattr(getattr(handler, "func", None), "__self__", None), asyncio.Runner)
