"""The emergency: the program's own last resort, where nothing else can be relied on."""

from __future__ import annotations

import inspect
import threading
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.runtime.handler import check_plain
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Emergency", "check_emergency"]


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
        """Have a function called, once each time, with those before it."""
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
