"""Readers: functions that tell a clock's time."""

from __future__ import annotations

from time import monotonic_ns
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["steady"]


def steady(offset: int) -> Callable[[], int]:
    """Return a function that tells the steady time, and so many nanoseconds more."""
    read = monotonic_ns
    return lambda: read() + offset
