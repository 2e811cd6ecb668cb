"""Attached: a process that ends with its starter, which holds the other end of its standard input."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mdm.runtime import Runtime

__all__ = ["Attached"]

_HELD = 3.0
"""Seconds after which an event loop that does not answer is held."""

_PATIENCE = 15.0
_BREATH = 0.2


class Attached:
    """Ends this process, in order where that can be, when its standard input ends.

    A thread waits for that, which a callback that holds the event loop does not keep from seeing it. An end in order
    has the time of its actors' limits. Where the starter of this process is gone, and so cannot end it, and the loop
    does not answer, the runtime's ``emergency`` is called and the process is killed.

    Args:
        descriptor: Standard input.
    """

    def __init__(self, descriptor: int = 0) -> None:
        self._descriptor = descriptor
        self._starter = os.getppid()
        self._runtime: Runtime | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._patience = _PATIENCE
        self._answered = threading.Event()
        threading.Thread(target=self._watch, name="mdm:attached", daemon=True).start()

    def hold(self, runtime: Runtime, patience: float) -> None:
        """Have a runtime end with standard input, on whose event loop this is called.

        Args:
            runtime: The runtime.
            patience: Seconds that its actors may take by their own limits.
        """
        self._loop, self._runtime, self._patience = asyncio.get_running_loop(), runtime, _PATIENCE + patience

    def _watch(self) -> None:
        with suppress(OSError):
            while os.read(self._descriptor, 4096):
                pass
        began, answered = time.monotonic(), time.monotonic()
        while time.monotonic() - began < self._patience:
            self._answered.clear()
            with suppress(RuntimeError):  # the loop has ended
                if self._loop is not None:
                    self._loop.call_soon_threadsafe(self._end)
            if self._answered.wait(_BREATH):
                answered = time.monotonic()
                time.sleep(_BREATH)
            elif os.getppid() != self._starter and time.monotonic() - answered > _HELD:
                break
        self._kill()

    def _end(self) -> None:
        """End the runtime; being called is the loop's answer."""
        self._answered.set()
        if self._runtime is not None:
            self._runtime.shut_down()

    def _kill(self) -> None:
        """Kill this process, with those that it has started; the emergency, if any, comes before."""
        if self._runtime is not None and self._loop is not None and not self._loop.is_closed():
            self._runtime.emergency("standard input has ended, and this process, which does not end, is killed")
            time.sleep(_BREATH)
        if os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)
