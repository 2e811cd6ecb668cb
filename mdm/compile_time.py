"""The time that compilation takes in this process: it is not the work's own, and who waits for it is told.

What is found in the compiler's cache takes none. The time goes on while something is compiled, and while the compiler
itself is loaded.
"""

from __future__ import annotations

from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["COMPILE_TIME", "CompileTime", "working_time"]

_LONG = 1.0
"""Seconds of compilation, in all, from which on somebody is told."""


class CompileTime:
    """A stopwatch for the compiler.

    Args:
        clock: Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self._depth = 0
        self._began = 0.0
        self._loading = 0.0
        self._compiling = 0.0
        self._tell: Callable[[], object] | None = None

    @property
    def seconds(self) -> float:
        """How long it took so far."""
        return self._loading + self._compiled

    @property
    def _compiled(self) -> float:
        return self._compiling + (self._clock() - self._began if self._depth else 0.0)

    @property
    def is_told(self) -> bool:
        """Whether somebody is told when it takes long."""
        return self._tell is not None

    @contextmanager
    def told(self, tell: Callable[[], object]) -> Iterator[None]:
        """Call a function within, once, when compilation has taken a second."""
        before, self._tell = self._tell, tell
        try:
            yield
        finally:
            self._tell = before

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Count the time within as that of loading the compiler, of which nobody is told."""
        began = self._clock()
        try:
            yield
        finally:
            self._loading += self._clock() - began

    def begin(self) -> None:
        """Something is compiled from now on; what it calls may be compiled within."""
        if not self._depth:
            self._began = self._clock()
        self._depth += 1

    def go_on(self) -> None:
        """Tell, if it is time to, that the compilation takes long."""
        if self._tell is not None and self._depth and self._compiled > _LONG:
            tell, self._tell = self._tell, None
            tell()

    def end(self) -> None:
        """What was begun last is compiled."""
        self._depth -= 1
        if not self._depth:
            self._compiling += self._clock() - self._began


COMPILE_TIME = CompileTime()
"""That of this process."""


def working_time() -> float:
    """Return seconds that do not go on while something is compiled."""
    return perf_counter() - COMPILE_TIME.seconds
