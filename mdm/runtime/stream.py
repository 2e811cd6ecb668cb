"""Streams: a channel's messages for a consumer outside the turn, bounded and with a declared overflow."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Generic, Literal, TypeVar

import anyio

from mdm.checks import check_choice, is_whole
from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType
    from typing import Self

    from mdm.checks import Whole

__all__ = ["Overflow", "Stream"]

T = TypeVar("T")


class Overflow(Error):
    """A stream with ``overflow="error"`` got more messages than its consumer took."""


class Stream(Generic[T]):
    """An asynchronous iterator over a channel's messages; also a context manager that unsubscribes.

    Args:
        name: The channel's name, for messages.
        capacity: How many messages may wait.
        overflow: The treatment of one too many.
        on_drop: Called for each message that is dropped.
    """

    def __init__(
        self,
        name: str,
        capacity: Whole,
        overflow: Literal["drop_oldest", "drop_newest", "error"],
        on_drop: Callable[[], None],
    ) -> None:
        if not is_whole(capacity) or capacity < 1:
            raise Error(f"a stream on channel {name!r} needs a capacity of at least 1, not {capacity!r}")
        check_choice(overflow, ("drop_oldest", "drop_newest", "error"), f"overflow of a stream on channel {name!r}")
        self._name = name
        self._capacity = int(capacity)
        self._overflow = overflow
        self._on_drop = on_drop
        self._on_close: Callable[[], None] = lambda: None
        self._waiting: deque[T] = deque()
        self._arrived = anyio.Event()
        self._ended = False
        self._failed = False
        self.dropped = 0

    def on_close(self, function: Callable[[], None]) -> None:
        """Set the function that unsubscribes the stream."""
        self._on_close = function

    def put(self, message: T) -> None:
        """Take a message from the turn; never waits."""
        if len(self._waiting) >= self._capacity:
            self.dropped += 1
            self._on_drop()
            if self._overflow == "error":
                self._failed = True
                self.close()
                return
            if self._overflow == "drop_newest":
                return
            self._waiting.popleft()
        self._waiting.append(message)
        self._arrived.set()

    def end(self) -> None:
        """Let the consumer take the waiting messages and then leave its loop."""
        self._ended = True
        self._arrived.set()

    def close(self) -> None:
        """Unsubscribe and end."""
        self._on_close()
        self.end()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        while not self._waiting:
            if self._failed:
                raise Overflow(
                    f"a consumer of channel {self._name!r} fell more than {self._capacity} messages behind; "
                    "take them faster, allow a larger capacity, or let the stream drop messages"
                )
            if self._ended:
                raise StopAsyncIteration
            if self._arrived.is_set():
                self._arrived = anyio.Event()  # one for all consumers that wait
            await self._arrived.wait()
        return self._waiting.popleft()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
