"""Pace: how many lines about a run people can follow; the rest is counted."""

from __future__ import annotations

from collections import Counter, deque

_LINES = 10
_SECOND = 1_000_000_000
_AGAIN = 10 * _SECOND


class Pace:
    """Lets ten lines a second pass, and of each subject those that are new, or the same again after ten seconds.

    Attributes:
        repeated: How often each subject's last line came again since it was written.
    """

    def __init__(self) -> None:
        self._written: deque[int] = deque(maxlen=_LINES)
        self._last: dict[str, tuple[object, int]] = {}
        self.repeated: Counter[str] = Counter()
        self._left_out = 0

    def counts(self, subject: str, line: object, time: int) -> dict[str, int] | None:
        """Return the counts that a line bears: how often it came again, how many were left out; None for no line.

        Args:
            subject: Whose line it is, such as an ensemble's path.
            line: Its content.
            time: In nanoseconds, at which it comes.
        """
        last, written = self._last.get(subject, (None, 0))
        if last == line and time - written < _AGAIN:
            self.repeated[subject] += 1
            return None
        if len(self._written) == _LINES and time - self._written[0] < _SECOND:
            self._left_out += 1
            return None
        self._written.append(time)
        self._last[subject] = line, time
        return {key: count for key, count in (("again", self.repeated.pop(subject, 0)), *self.rest().items()) if count}

    def rest(self) -> dict[str, int]:
        """Return how many lines were left out since the last one, and count from there."""
        left_out, self._left_out = self._left_out, 0
        return {"left_out": left_out} if left_out else {}
