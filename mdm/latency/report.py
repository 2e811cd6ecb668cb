"""The report of a measurement: a row for each way in which a stimulus comes."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import msgspec
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence


class Row(msgspec.Struct, frozen=True):
    """The latencies of one way in which stimuli come.

    Attributes:
        name: The way.
        p50: The median in seconds; None where nothing was measured, as are the others.
        p99: The 99th percentile in seconds.
        worst: The longest in seconds.
        count: How many were measured.
        undecided: Stimuli that led to no call of an action, and are not among them.
        histogram: Pairs of a time in seconds, each twice one before it, and how many took at most that, but longer than
            its half.
        needs: The package that has to be installed, where the row could not be measured.
    """

    name: str
    p50: float | None = None
    p99: float | None = None
    worst: float | None = None
    count: int = 0
    undecided: int = 0
    histogram: tuple[tuple[float, int], ...] = ()
    needs: str = ""

    @classmethod
    def of(cls, name: str, nanoseconds: Sequence[int], undecided: int = 0) -> Row:
        """Return the row of these latencies.

        Args:
            name: The way in which the stimuli came.
            nanoseconds: The latencies; without any, the row has no quantiles.
            undecided: How many stimuli led to no call of an action.
        """
        if not nanoseconds:
            return cls(name, undecided=undecided)
        p50, p99, worst = (np.quantile(nanoseconds, (0.5, 0.99, 1)) / 1e9).tolist()
        octaves = Counter((max(each, 1) - 1).bit_length() for each in nanoseconds)
        histogram = tuple((2**octave / 1e9, octaves[octave]) for octave in sorted(octaves))
        return cls(name, p50, p99, worst, len(nanoseconds), undecided, histogram)


class Report(msgspec.Struct, frozen=True):
    """How long decisions take.

    Attributes:
        rows: A row for each way in which stimuli came.
        faster: Advice on making decisions faster, a sentence each.
        faults: How many faults of each kind there were meanwhile.
        seconds: For how long was measured.
    """

    rows: tuple[Row, ...]
    faster: tuple[str, ...]
    faults: dict[str, int]
    seconds: float

    def row(self, name: str) -> Row:
        """Return the row of a name.

        Raises:
            KeyError: If there is none.
        """
        return {row.name: row for row in self.rows}[name]
