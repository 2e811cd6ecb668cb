"""Stand-ins for users' functions: they last as long as recorded, and say within their calls and tasks what was said."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

__all__ = ["AsRecordedError", "StandIn"]


class AsRecordedError(Error):
    """The error of an action, as the record tells it."""


class _Command(asyncio.Future[None]):
    """Waits for the next command; whoever cancels the stand-in has no say in when that ends.

    Args:
        cancel: What is told of a cancellation.
    """

    def __init__(self, cancel: Callable[[], bool]) -> None:
        super().__init__()
        self._cancel = cancel

    def cancel(self, msg: Any | None = None) -> bool:
        """Take the cancellation, and go on waiting."""
        return self._cancel()


class StandIn:
    """An awaitable in place of that of an action's function.

    It passes for a future, so that a cancellation before its first step does not end it either: the record says when it
    ends. One that is released, for the record does not say that, lasts until it is cancelled.
    """

    _asyncio_future_blocking = False

    def __init__(self) -> None:
        self._commands: deque[tuple[Callable[[], object], asyncio.Future[None]]] = deque()
        self._waiting: _Command | None = None
        self._over = False
        self._released = False

    def cancel(self, msg: Any | None = None) -> bool:
        """Take a cancellation, before the first step or later."""
        if self._released:
            self.end()
        return True

    def release(self) -> None:
        """Have the next cancellation end it."""
        self._released = True

    def __await__(self) -> Generator[Any, None, None]:
        """Carry out commands until the end."""
        while not self._is_over():
            while self._commands:
                command, done = self._commands.popleft()
                try:
                    command()
                finally:
                    if not done.done():
                        done.set_result(None)
                if self._is_over():
                    return
            self._waiting = _Command(self.cancel)
            yield from self._waiting

    def _is_over(self) -> bool:
        return self._over

    async def do(self, command: Callable[[], object]) -> None:
        """Have something done within the task, and wait until it is."""
        done = asyncio.get_running_loop().create_future()
        self._commands.append((command, done))
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
        await done

    def end(self, error: BaseException | None = None) -> None:
        """End it, with an error where one is given."""

        def leave() -> None:
            self._over = True
            if error is not None:
                raise error

        self._commands.append((leave, asyncio.get_running_loop().create_future()))
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
