"""Batches: what is reported together, and becomes one update."""

from __future__ import annotations

import sys
from asyncio import _get_running_loop
from threading import get_ident
from typing import TYPE_CHECKING

if sys.version_info >= (3, 12):
    from asyncio import current_task
else:  # there `asyncio.current_task` is plain Python around a look-up, and takes three times as long as that
    from asyncio.tasks import _current_tasks  # type: ignore[attr-defined]

    current_task = _current_tasks.get

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.runtime.dispatcher import Dispatcher

__all__ = ["Batch", "Batches"]

Value = tuple[str, "bool | None"]


class Batches:
    """The open batches of a predicate manager: one a task, or outside of tasks one a thread.

    Args:
        tell: Takes what a batch has gathered, at its end.

    Attributes:
        dispatcher: The predicate manager's, once that has been started.
        open: By task or thread.
    """

    __slots__ = ("dispatcher", "open", "tell")

    def __init__(self, tell: Callable[[tuple[Value, ...], tuple[str, ...]], object]) -> None:
        self.tell = tell
        self.dispatcher: Dispatcher | None = None
        self.open: dict[object, Batch] = {}

    def scope(self) -> object:
        """Return what runs: an asyncio task, or else a thread.

        Hot path: which loop runs takes a system call to find out, and a dispatcher's own thread runs its loop.
        """
        thread, dispatcher = get_ident(), self.dispatcher
        if dispatcher is not None and dispatcher.thread == thread and dispatcher.loop is not None:
            return current_task(dispatcher.loop) or thread
        loop = _get_running_loop()  # None where none runs, in place of an exception
        return thread if loop is None else current_task(loop) or thread


class Batch:
    """A block in which values of predicates, the latest of each, and events, in their order, are gathered.

    Within another batch of the same task or thread it leaves all to that one.

    Args:
        batches: The predicate manager's open ones.

    Attributes:
        readings: Predicates with their values, by name.
        events: Their names.
    """

    __slots__ = ("_batches", "_scope", "events", "readings")

    def __init__(self, batches: Batches) -> None:
        self._batches = batches
        self._scope: object = None

    def __enter__(self) -> None:
        """Gather from now on what the present task or thread reports."""
        found = self._batches.scope()
        if self._batches.open.setdefault(found, self) is self:
            self._scope = found
            self.readings: dict[str, Value] = {}
            self.events: tuple[str, ...] = ()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Tell what was gathered, whoever calls this and whatever was raised.

        Hot path: arguments that have names each are what CPython calls at once, and so is what `tell` names.
        """
        if self._scope is None:
            return
        batches = self._batches
        del batches.open[self._scope]
        self._scope = None
        if self.readings or self.events:
            tell = batches.tell
            tell(tuple(self.readings.values()), self.events)
