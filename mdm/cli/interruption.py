"""Ctrl-C, SIGTERM and SIGHUP while something is computed whose result so far is worth having."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

_NUMBERS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def hear_interrupts() -> None:
    """Have SIGINT end this process in order, where a shell that is no terminal's ignores it for its background.

    A process that drives a robot has to stop at it; other signals that are ignored, as SIGHUP after ``nohup``, stay so.
    """
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


class Interruption:
    """Notes the first Ctrl-C, SIGTERM or SIGHUP that comes while it is deferred; the second is a `KeyboardInterrupt`.

    Until there is something worth having the first is one as well. It is noted all the same, because the code that it
    breaks off may swallow it, as compilers do: who computes asks for it now and then.

    Attributes:
        number: The signal that came; None before.
        begun: Whether there is something worth having.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self.begun = False

    @property
    def status(self) -> int:
        """The exit status for the signal."""
        return 128 + (self.number or signal.SIGINT)

    def asked(self) -> bool:
        """Return whether a signal has come; from now on there is something worth having."""
        self.begun = True
        return self.number is not None

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Note signals within; those that the program or its parent process handles or ignores stay so."""
        ours: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            for number in _NUMBERS:
                if (found := signal.getsignal(number)) in (signal.default_int_handler, signal.SIG_DFL):
                    ours[number] = found
                    signal.signal(number, self._take)
        try:
            yield
        finally:
            for each, before in ours.items():
                signal.signal(each, before)

    def _take(self, number: int, _: object) -> None:
        first = self.number is None
        if first:
            self.number = number
        if number != signal.SIGINT and signal.getsignal(signal.SIGINT) != self._take:
            signal.raise_signal(signal.SIGINT)  # a solver takes that to return what it has
        elif not first or not self.begun:
            raise KeyboardInterrupt
