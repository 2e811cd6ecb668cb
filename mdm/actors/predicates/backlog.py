"""The backlog: what sensors are told for the next start of their predicate manager."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["Backlog"]


class Backlog:
    """The last value that each sensor was told before a start, or since the failure that leads to one.

    Attributes:
        values: By predicate.
    """

    __slots__ = ("_times", "values")

    def __init__(self) -> None:
        self.values: dict[str, bool | None] = {}
        self._times: dict[str, int] = {}

    def put(self, readings: Iterable[tuple[str, bool | None]], time: int | None) -> None:
        """Take values, told at a time in nanoseconds; None before the first start, when there is no clock."""
        for name, value in readings:
            self.values[name] = value
            if time is not None:
                self._times[name] = time

    def expire(self, now: int, limits: Mapping[str, int]) -> None:
        """Forget what is older than it may become."""
        for name, limit in limits.items():
            if now - self._times.get(name, now) > limit:
                self.values.pop(name, None)

    def told(self, name: str, now: int) -> int:
        """Return when a sensor was told its value; now, where that is not known."""
        return self._times.get(name, now)

    def clear(self) -> None:
        """Forget everything."""
        self.values.clear()
        self._times.clear()
