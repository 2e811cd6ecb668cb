"""Supervision: the consequences of an actor's failure."""

from __future__ import annotations

import asyncio
import os
import sysconfig
import traceback
from collections import deque
from pathlib import Path
from typing import Literal

import msgspec

from mdm.checks import is_number, is_whole
from mdm.errors import ConfigError, Error
from mdm.runtime.time.clock import check_seconds
from mdm.texts import encodable

LEAVING = (SystemExit, KeyboardInterrupt)
"""What ends the program, in order, in place of being one actor's failure."""


_TOLD = 5
_LIBRARIES = tuple(
    f"{folder}{os.sep}"
    for folder in (Path(__file__).parents[1], *map(sysconfig.get_path, ("stdlib", "platstdlib", "purelib", "platlib")))
)
"""The folders of code that is not the program's: this library, Python's, and those installed."""


class ActorFailure(Error):
    """An actor failed, and nobody above it could help; the cause is the error that it raised.

    Attributes:
        escalated: Whether it came from an actor below: it then names the one that failed first.
    """

    escalated = False


class Restart(msgspec.Struct, frozen=True):
    """Start a failed actor again, at most ``limit`` times ``within`` seconds; one time more escalates.

    Attributes:
        limit: Restarts allowed in the window.
        within: The window's length in seconds.
        backoff: Seconds before the first restart of a window; each further one waits twice as long.
        max_backoff: The longest wait in seconds.
    """

    limit: int = 3
    within: float = 60.0
    backoff: float = 0.1
    max_backoff: float = 5.0

    def __post_init__(self) -> None:
        """Refuse counts and times that are not positive.

        Raises:
            ConfigError: If the limit is no whole number, or a time no number of seconds.
        """
        if not is_whole(self.limit) or self.limit < 0:
            raise ConfigError(f"limit of Restart(...) is a whole number from 0 on, not {self.limit!r}", key="limit")
        check_seconds(self.within, "within of Restart(...)", key="within")
        for name in ("backoff", "max_backoff"):
            seconds = getattr(self, name)
            if not is_number(seconds) or not 0 <= seconds <= 1e9:
                raise ConfigError(
                    f"{name} of Restart(...) is a number of seconds from 0 to 10^9, not {seconds!r}", key=name
                )


Supervision = Restart | Literal["stop", "escalate"]
"""What a failure means: start again, stop that actor alone, or let it be the parent's failure."""


def check_supervision(given: object) -> None:
    """Refuse an object that is no supervision.

    Raises:
        ConfigError: If it is no supervision.
    """
    if not isinstance(given, Restart) and not (isinstance(given, str) and given in {"stop", "escalate"}):
        raise ConfigError(f"supervision is 'stop', 'escalate' or Restart(...), not {given!r}", key="supervision")


class RestartBudget:
    """Counts the restarts of one actor in a sliding window."""

    __slots__ = ("_policy", "_times")

    def __init__(self, policy: Restart) -> None:
        self._policy = policy
        self._times: deque[int] = deque()

    def delay(self, now: int) -> float | None:
        """Return after how many seconds to restart, or None if there were too many restarts already."""
        times, policy = self._times, self._policy
        while times and now - times[0] > policy.within * 1e9:
            times.popleft()
        if len(times) >= policy.limit:
            return None
        times.append(now)
        doubled = 2.0 ** min(len(times) - 1, 1000)  # beyond that a float overflows
        return float(min(policy.backoff * doubled, policy.max_backoff))


def describe(error: BaseException) -> str:
    """Return one sentence for an error: its type, its text, and where in the code it came from.

    The place is the last line of the program's own code, not one of this library or of others that it called. An error
    of ours that no such line has led to is about something else than code, and has no place. A group says where each of
    its errors came from, not where they were gathered.
    """
    return encodable(f"{type(error).__name__}: {text_of(error)}{_place(error)}")


def _place(error: BaseException) -> str:
    """Return where an error came from, in brackets; empty where nothing is to be corrected at a place."""
    if isinstance(error, BaseExceptionGroup):
        return ""
    frames = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    own = [frame for frame in frames if not frame[0].startswith(("<", *_LIBRARIES))]
    if not own and isinstance(error, Error):
        return ""
    beyond = own or [frame for frame in frames if not frame[0].startswith(_LIBRARIES[0])]
    return "".join(f" (at {file}:{line})" for file, line in (beyond or frames)[-1:])


def text_of(error: BaseException) -> str:
    """Return an error's own text, or say that it has none: an error whose text fails is a failure all the same.

    That of a group, which only counts its errors, is followed by their texts, group within group.
    """
    try:
        text = encodable(str(error))
    except BaseException as another:
        return f"its text cannot be read: that raises {type(another).__name__}"
    if not isinstance(error, BaseExceptionGroup):
        return text
    inner = _inner(error)
    more = f"; and {len(inner) - _TOLD} more" if len(inner) > _TOLD else ""
    return encodable(f"{text}: {'; '.join(map(describe, inner[:_TOLD]))}{more}")


def _inner(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    """Return the errors of a group and of those within it, in their order."""
    found: list[BaseException] = []
    waiting: list[BaseException] = [group]
    while waiting:
        error = waiting.pop()
        if isinstance(error, BaseExceptionGroup):
            waiting += reversed(error.exceptions)
        else:
            found.append(error)
    return found


def failure(error: BaseException) -> BaseException:
    """Return an error as those who wait may be told it: one that a plain function raised cancels nobody else."""
    if isinstance(error, (Exception, *LEAVING)):
        return error
    raised = ActorFailure(describe(error))
    raised.__cause__ = error
    return raised


def was_cancelled(error: BaseException) -> bool:
    """Whether an error is the present task's own cancellation, requested by its owner."""
    task = asyncio.current_task()
    return isinstance(error, asyncio.CancelledError) and task is not None and task.cancelling() > 0
