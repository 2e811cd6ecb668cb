"""Linux's ``timerfd``: a timer that an event loop can wait for as for a file, exact to microseconds.

The standard library has it from Python 3.13 on; before that it is reached through the C library. See timerfd_create(2).
"""

from __future__ import annotations

import ctypes
import os
import sys
import time

__all__ = ["acknowledge", "available", "close", "create", "set_time"]

_ABSOLUTE = 1


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _TimeSpec), ("value", _TimeSpec))


def _library() -> ctypes.CDLL | None:
    if sys.platform != "linux":
        return None
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "timerfd_create"):
        return None
    library.timerfd_settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_TimerSpec), ctypes.c_void_p)
    return library


_LIBRARY = _library()
available = _LIBRARY is not None


def create() -> int:
    """Return the descriptor of a new, non-blocking timer on the steady clock.

    Raises:
        OSError: If the process has no descriptors left, or the platform has no such timers.
    """
    descriptor = -1 if _LIBRARY is None else _LIBRARY.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create failed")
    return int(descriptor)


def set_time(descriptor: int, when: int) -> None:
    """Fire once when the steady clock shows ``when`` nanoseconds (at once if that has passed)."""
    seconds, nanoseconds = divmod(max(when, 1), 1_000_000_000)
    spec = _TimerSpec(_TimeSpec(0, 0), _TimeSpec(seconds, nanoseconds))
    if _LIBRARY is None or _LIBRARY.timerfd_settime(descriptor, _ABSOLUTE, ctypes.byref(spec), None) < 0:
        raise OSError(ctypes.get_errno(), "timerfd_settime failed")


def acknowledge(descriptor: int) -> bool:
    """Return whether the timer has fired since it was last asked."""
    try:
        os.read(descriptor, 8)
    except BlockingIOError:
        return False
    return True


def close(descriptor: int) -> None:
    """Give the descriptor back."""
    os.close(descriptor)
