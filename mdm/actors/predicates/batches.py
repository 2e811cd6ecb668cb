"""Batches: what is reported together, and becomes one update."""

from __future__ import annotations

from asyncio import _get_running_loop, current_task
from threading import get_ident
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.runtime.dispatcher import Dispatcher

__all__ = ["Batch", "scope"]

Values = tuple[tuple[str, "bool | None"], ...]


class Batch:
    """A block in which values of predicates, the latest of each, and events, in their order, are gathered.

    Within another batch of the same task or thread it leaves all to that one.

    Args:
        batches: The open batches: one a task, or outside of tasks one a thread.
        tell: Takes what was gathered, at the end.
        dispatcher: The predicate manager's, once that has been started.

    Attributes:
        readings: Predicates with their values.
        events: Their names.
    """

    __slots__ = ("_batches", "_dispatcher", "_scope", "_tell", "events", "readings")

    def __init__(
        self,
        batches: dict[object, Batch],
        tell: Callable[[Values, tuple[str, ...]], object],
        dispatcher: Dispatcher | None,
    ) -> None:
        self.readings: dict[str, bool | None] = {}
        self.events: list[str] = []
        self._batches = batches
        self._tell = tell
        self._dispatcher = dispatcher
        self._scope: object = None

    def __enter__(self) -> None:
        """Gather from now on what the present task or thread reports."""
        found = scope(self._dispatcher)
        if found not in self._batches:
            self._batches[found] = self
            self._scope = found

    def __exit__(self, *_: object) -> None:
        """Tell what was gathered, whoever calls this and whatever was raised."""
        if self._scope is None:
            return
        del self._batches[self._scope]
        self._scope = None
        readings, events = self.readings, self.events
        if readings or events:
            self.readings, self.events = {}, []
            self._tell(tuple(readings.items()), tuple(events))


def scope(dispatcher: Dispatcher | None) -> object:
    """Return what runs: an asyncio task, or else a thread.

    Hot path: which loop runs takes a system call to find out, and a dispatcher's own thread runs its loop.
    """
    thread = get_ident()
    loop = dispatcher.loop if dispatcher is not None and dispatcher.thread == thread else None
    if loop is None:
        loop = _get_running_loop()  # None where none runs, in place of an exception
    return thread if loop is None else current_task(loop) or thread
