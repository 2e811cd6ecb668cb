"""The start of an actor, as seen by whoever waits for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import anyio

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Start"]


class Start:
    """Tells whoever starts an actor that it runs, or what its start raised.

    Args:
        untold: Called with what the start raised, where whoever started the actor was cancelled and waits no more.
    """

    def __init__(self, untold: Callable[[BaseException], object]) -> None:
        self._untold = untold
        self._left = False
        self._event = anyio.Event()
        self._error: BaseException | None = None

    def done(self) -> None:
        """Say that the actor runs."""
        self._event.set()

    def failed(self, error: BaseException | None) -> None:
        """Say that it has ended; before it ran, because of an error."""
        if not self._event.is_set():
            self._error = error
            self._event.set()
            self._tell_otherwise()

    def _tell_otherwise(self) -> None:
        if self._left and self._error is not None:
            self._untold(self._error)

    async def wait(self) -> None:
        """Wait until it runs; raise what its start raised."""
        try:
            await self._event.wait()
        except BaseException:
            self._left = True
            self._tell_otherwise()
            raise
        if self._error is not None:
            raise self._error
