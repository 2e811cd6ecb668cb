"""Progress on standard error: one line that changes on a terminal, a few lines elsewhere."""

from __future__ import annotations

import math
import sys
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING, TextIO

from mdm.progress import followed
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mdm.cli.interruption import Interruption
    from mdm.solvers import Progress

_OFTEN = 0.1
_FIRST = 2.0
_SELDOM = 60.0


class ProgressLine:
    """Prints progress.

    A terminal has one line, after two seconds, which is updated at most ten times a second. Elsewhere lines are
    printed after 1, 2, 4, ... seconds and then once a minute. Once it cannot be printed, as when the terminal has gone,
    it stops: the work that it is about goes on.

    Args:
        stream: The output; by default standard error.
        limit: Seconds after which the work ends at the latest, if that is known.
    """

    def __init__(self, stream: TextIO | None = None, *, limit: float | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._live = self._stream is not None and self._stream.isatty()
        self._next = _FIRST if self._live else 1.0
        self._limit = math.inf if limit is None else limit
        self._shown = False

    def __call__(self, progress: Progress) -> None:
        """Print a solver's progress if it is due."""
        left = f"  at most {to_go(self._limit - progress.seconds)}" if math.isfinite(self._limit) else ""
        self.tell(progress.seconds, lambda: f"{_text(progress)}{left}")

    def tell(self, seconds: float, text_of: Callable[[], str]) -> None:
        """Print a text after so many seconds, if one is due."""
        if seconds < self._next or self._stream is None:
            return
        self._next = seconds + (_OFTEN if self._live else min(max(seconds, 1.0), _SELDOM))
        text = text_of()
        self._print(f"\r\x1b[K{text}" if self._live else f"{text}\n")
        self._shown = True

    def end(self) -> None:
        """Clear the line on a terminal."""
        if self._live and self._shown:
            self._print("\r\x1b[K")

    def _print(self, text: str) -> None:
        if self._stream is not None:
            try:
                self._stream.write(text)
                self._stream.flush()
            except OSError:
                self._stream = None


@contextmanager
def counting(interruption: Interruption, what: str = "", noun: str = "episode") -> Iterator[Callable[[int, int], bool]]:
    """Yield a function that prints how many of how many have ended, and returns True after a signal.

    Args:
        interruption: Notes Ctrl-C, SIGTERM and SIGHUP meanwhile.
        what: The text before the numbers.
        noun: A word for one of them.
    """
    line, began, before = ProgressLine(), perf_counter(), -1

    def count(ended: int, total: int) -> bool:
        nonlocal before
        before = ended if before < 0 else before  # what was done earlier took no time of this run
        seconds, done = perf_counter() - began, ended - before
        left = f"  about {to_go(seconds * (total - ended) / done)}" if done else ""
        line.tell(seconds, lambda: f"{seconds:.1f} s  {what}{ended} of {counted(total, noun)}{left}")
        return interruption.asked()

    with interruption.deferred():
        try:
            yield count
        finally:
            line.end()


@contextmanager
def work_shown() -> Iterator[None]:
    """Show on a terminal how far work has come that reports its share, such as the reading of a large file."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    line, current, began = ProgressLine(), "", 0.0

    def tell(work: str, share: float) -> None:
        nonlocal line, current, began
        now = perf_counter()
        if work != current or not share:
            line.end()
            line, current, began = ProgressLine(), work, now
        seconds = now - began
        left = f"  about {to_go(seconds * (1 - share) / share)}" if share else ""
        line.tell(seconds, lambda: f"{seconds:.1f} s  {work}  {share:.0%}{left}")
        if share == 1:
            line.end()

    try:
        with followed(tell):
            yield
    finally:
        line.end()


def to_go(seconds: float) -> str:
    """Return how much time is left as text."""
    seconds = max(round(seconds), 0)
    if seconds < 100:
        return f"{seconds} s to go"
    minutes, rest = divmod(seconds, 60)
    return f"{minutes} min {rest} s to go" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min to go"


def bound(value: float) -> str:
    """Return a bound as text; a question mark if it is infinite."""
    return f"{value:.6g}" if math.isfinite(value) else "?"


def _text(progress: Progress) -> str:
    gap = f"gap {progress.gap:.3g}  " if math.isfinite(progress.gap) else ""
    return (
        f"{progress.seconds:.1f} s  value at the start {bound(progress.lower)} to {bound(progress.upper)}  {gap}"
        f"iteration {progress.iterations}  size {progress.size}  {progress.memory / 1e6:.0f} MB"
    )
