"""The writer: a thread for calls that could keep the event loop waiting.

Standard error may be a pipe that nobody reads. Then a write waits, and with it its caller.
"""

from __future__ import annotations

import contextvars
import operator
import os
import select
import sys
import threading
from contextlib import suppress
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TextIO

from mdm.runtime.statistics import LogStatistics

if TYPE_CHECKING:
    from collections.abc import Callable

_BOUND = 4096
_LOOK = 0.05
_PIPE = getattr(select, "PIPE_BUF", 512)


class Writer:
    """Calls functions in the order in which they came; calls that cannot be made at once wait, up to a bound.

    A call that is one too many, or fails, is lost and counted. ``put`` never waits, and may be called from any thread.

    Attributes:
        given_up: Whether nobody waits for a reader any more.
        on_loss: Called with why something is lost, from any thread.
    """

    def __init__(self) -> None:
        self.given_up = False
        self.on_loss: Callable[[Exception | str], object] = lambda _: None
        self._queue: SimpleQueue[tuple[Callable[[Any], object], Any] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._written = 0
        self._failed = 0
        self._refused = 0

    def open(self) -> None:
        """Write on a thread from now on, within the context variables of the caller."""
        context = contextvars.copy_context()
        thread = threading.Thread(target=context.run, args=(self._work,), name="mdm:log", daemon=True)
        thread.start()
        self._thread = thread

    def put(self, write: Callable[[Any], object], message: object) -> None:
        """Write a message: by the thread, or at once where there is none."""
        if self._thread is None:
            self._call(write, message)
        elif self._queue.qsize() < _BOUND:
            self._queue.put((write, message))
        else:
            self._refused += 1
            self.on_loss(f"{_BOUND:,} lines wait, and nobody reads them")

    def close(self, seconds: float = 0.5) -> None:
        """Write the waiting lines, for no longer than some seconds; the rest is lost."""
        thread = self._thread
        if thread is not None:
            self._queue.put(None)
            thread.join(seconds)
            self.given_up = True
            thread.join(2 * _LOOK)
            self._thread = None

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            self._call(*item)

    def _call(self, write: Callable[[Any], object], message: object) -> None:
        try:
            if self.given_up:
                raise BrokenPipeError
            write(message)
        except Exception as error:  # a log that fails must end nothing
            self._failed += 1
            if not self.given_up:
                with suppress(Exception):  # a runtime that has ended is told nothing
                    self.on_loss(error)
        else:
            self._written += 1

    def statistics(self) -> LogStatistics:
        """Return how many lines were written, and how many lost."""
        return LogStatistics(written=self._written, lost=self._failed + self._refused)


class Stream:
    """A stream of text, written to without a buffer.

    A thread that waits inside Python's buffer of a stream would end the interpreter with an error at its exit. A stream
    that is none of the operating system's, as consoles of other programs set it, need only have `write`.

    Args:
        stream: Standard error or output, or None where there is none.
        given_up: Tells whether to wait no longer for a reader.
    """

    def __init__(self, stream: TextIO | None, given_up: Callable[[], bool]) -> None:
        self._given_up = given_up
        self._stream = stream
        self._descriptor: int | None = None
        if self._stream is not None and hasattr(select, "poll"):
            with suppress(Exception):  # else it is none of the operating system's
                self._descriptor = operator.index(self._stream.fileno())

    @property
    def colours(self) -> bool:
        """Whether it is a terminal, and the environment variable NO_COLOR forbids none."""
        is_terminal = getattr(self._stream, "isatty", None)
        return is_terminal is not None and bool(is_terminal()) and not os.environ.get("NO_COLOR")

    def write(self, line: str) -> None:
        """Write a line.

        Raises:
            OSError: If there is no standard error, nobody reads it, or it takes no more.
        """
        if self._stream is None:
            raise BrokenPipeError("there is nothing to write to")
        if self._descriptor is None:
            self._stream.write(line + "\n")
            if hasattr(self._stream, "flush"):
                self._stream.flush()
            return
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        data = memoryview(f"{line}\n".encode(encoding, "backslashreplace"))
        ready = select.poll()
        ready.register(self._descriptor, select.POLLOUT)
        while data:
            if ready.poll(1000 * _LOOK):
                data = data[os.write(self._descriptor, data[:_PIPE]) :]  # a pipe that is ready takes so much at once
            elif self._given_up():
                raise BrokenPipeError("nobody reads what is written")

    debug = info = warning = error = write


class StandardError(Stream):
    """Standard error as it is now.

    Args:
        given_up: Tells whether to wait no longer for a reader.
    """

    def __init__(self, given_up: Callable[[], bool]) -> None:
        super().__init__(sys.stderr, given_up)
