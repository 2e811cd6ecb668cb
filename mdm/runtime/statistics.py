"""Statistics: frozen snapshots of the counts of actors and channels, and a histogram of latencies."""

from __future__ import annotations

from array import array
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

FULL: Final = 4096
_BUCKETS = 8 * 64


class _Snapshot(msgspec.Struct, frozen=True):
    """A snapshot, which prints the fields that are not zero or empty."""

    def __repr__(self) -> str:
        told = [f"{name}={value!r}" for name in self.__struct_fields__ if (value := getattr(self, name))]
        return f"{type(self).__name__}({', '.join(told)})"

    def told(self, *others: str) -> str:
        """Return the fields that are not zero or empty, but for some, in words for a line of their own."""
        told = ((name, getattr(self, name)) for name in self.__struct_fields__ if name not in others)
        return "  ".join(f"{name.replace('_', ' ')} {_in_words(value)}" for name, value in told if value)


def _in_words(value: object) -> str:
    if isinstance(value, Histogram):
        return f"{value.quantile(0.5):.3g} s (at most {value.maximum:.3g} s)"
    if isinstance(value, dict):
        return ", ".join(f"{count} {what}" for what, count in value.items())
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


class ChannelStatistics(_Snapshot, frozen=True):
    """The messages that crossed a channel.

    Attributes:
        name: Of the channel.
        published: Messages that were published on it.
        last: The stamp of the last one in nanoseconds; None before the first.
        dropped: Messages that a bounded stream or a stopped actor did not take.
        unheard: Messages that had no subscriber.
        subscribers: Handlers that are subscribed now.
        streams: Streams that are open now.
    """

    name: str
    published: int
    last: int | None
    dropped: int
    unheard: int
    subscribers: int
    streams: int


class ActorStatistics(_Snapshot, frozen=True):
    """The counts of an actor.

    Attributes:
        path: Its place in the tree of actors.
        state: Of its life: ``running``, ``stopped``, ``failed`` and others, see `mdm.messages.StateChange`.
        received: Messages that its handlers were called with.
        failures: Errors of its handlers, its work and its start.
        restarts: How often it was started again after one.
        work: Calls and coroutines that are under way now.
        skipped_ticks: Ticks of its timers that the event loop came too late for.
    """

    path: str
    state: str
    received: int
    failures: int
    restarts: int
    work: int
    skipped_ticks: int


class DispatcherStatistics(_Snapshot, frozen=True):
    """The counts of a dispatcher, which runs handlers in turns.

    Attributes:
        turns: Turns that were run.
        interrupted: Of these, turns that were cut short to let the event loop breathe.
        from_threads: Messages that came from other threads.
        replaced: Of these, messages that a newer one superseded while they waited.
        lost: Of these, messages that were too many.
        refused: Messages of other threads that came after the end, and decided nothing; and those refused before it
            began, or in a forked process.
    """

    turns: int
    interrupted: int
    from_threads: int
    replaced: int
    lost: int
    refused: int


class LogStatistics(_Snapshot, frozen=True):
    """The lines of the log.

    Attributes:
        written: Lines that were written.
        lost: Lines that were not: nobody read them in time, or nobody could.
    """

    written: int
    lost: int


class Histogram(msgspec.Struct, frozen=True):
    """A latency histogram: counts per bucket, each bucket an eighth of an octave wide; times in seconds."""

    count: int
    total: float
    maximum: float
    counts: tuple[int, ...]

    def __bool__(self) -> bool:
        """Whether anything was recorded."""
        return self.count > 0

    def __repr__(self) -> str:
        """Return how many there were and how long they took, in place of the buckets."""
        if not self.count:
            return "Histogram(count=0)"
        median, late = self.quantile(0.5), self.quantile(0.99)
        return (
            f"Histogram(count={self.count}, median={median:.3g} s, 99 % within {late:.3g} s, "
            f"maximum={self.maximum:.3g} s)"
        )

    def quantile(self, fraction: float) -> float:
        """Return the upper bound in seconds of the bucket in which the given fraction of all latencies has come.

        Exact to an eighth of an octave; 0 where nothing was recorded.
        """
        if not self.count:
            return 0.0
        reached = np.cumsum(self.counts)
        bucket = int(np.searchsorted(reached, fraction * self.count))
        octave, eighth = divmod(bucket, 8)
        return min(2.0**octave * (1 + (eighth + 1) / 8) / 1e9, self.maximum)


class Latencies:
    """Records latencies in nanoseconds; a record costs one append, the histogram is made when it is asked for.

    Attributes:
        pending: The latest records. A hot path may append to it by itself, and calls `fold` where it is `FULL`.
    """

    __slots__ = ("_counts", "_maximum", "_total", "pending")

    def __init__(self) -> None:
        self.pending = array("q")
        self._counts: npt.NDArray[np.int64] = np.zeros(_BUCKETS, dtype=np.int64)
        self._total = 0
        self._maximum = 0

    def record(self, nanoseconds: int) -> None:
        """Count one latency."""
        pending = self.pending
        pending.append(nanoseconds)
        if len(pending) >= FULL:
            self.fold()

    def fold(self) -> None:
        """Count the pending records."""
        self._counts, self._total, self._maximum = self._folded()
        del self.pending[:]

    def _folded(self) -> tuple[npt.NDArray[np.int64], int, int]:
        if not self.pending:
            return self._counts, self._total, self._maximum
        values = np.maximum(np.array(self.pending, dtype=np.int64), 1)
        fraction, exponent = np.frexp(values.astype(np.float64))
        buckets = (exponent - 1) * 8 + ((fraction * 2 - 1) * 8).astype(np.int64)
        counts = self._counts + np.bincount(buckets, minlength=_BUCKETS)
        return counts, self._total + int(values.sum()), max(self._maximum, int(values.max()))

    def snapshot(self) -> Histogram:
        """Return the histogram so far; who looks at it changes nothing of when the pending records are counted."""
        counts, total, maximum = self._folded()
        return Histogram(
            count=int(counts.sum()), total=total / 1e9, maximum=maximum / 1e9, counts=tuple(counts.tolist())
        )


class LoopStatistics(_Snapshot, frozen=True):
    """How an event loop turned, as its watchdog saw it.

    Attributes:
        stalls: How often it did not turn for as long as the watchdog's limit.
        delays: The times that it took to answer the watchdog: a call that held it shows, below the limit too.
    """

    stalls: int
    delays: Histogram
