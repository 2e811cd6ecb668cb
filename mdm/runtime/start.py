"""The start of an actor, as seen by whoever waits for it."""

from __future__ import annotations

import anyio

__all__ = ["Start"]


class Start:
    """Tells whoever starts an actor that it runs, or what its start raised."""

    def __init__(self) -> None:
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

    async def wait(self) -> None:
        """Wait until it runs; raise what its start raised."""
        await self._event.wait()
        if self._error is not None:
            raise self._error
