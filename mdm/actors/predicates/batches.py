"""Batches: what is reported together, and becomes one update."""

from __future__ import annotations

import asyncio
from threading import get_ident

__all__ = ["Batch", "Batches"]


class Batch:
    """Values of predicates, the latest of each, and events in their order.

    Args:
        scope: The task or thread whose it is.

    Attributes:
        values: By predicate.
        events: Their names.
    """

    __slots__ = ("events", "scope", "values")

    def __init__(self, scope: object) -> None:
        self.scope = scope
        self.values: dict[str, bool | None] = {}
        self.events: list[str] = []


class Batches:
    """The open batches: one a task, or outside of tasks one a thread.

    Attributes:
        open: By the task or thread that has begun it.
    """

    __slots__ = ("open",)

    def __init__(self) -> None:
        self.open: dict[object, Batch] = {}

    def begin(self) -> Batch | None:
        """Open a batch for whoever calls this; None where there is one already, which takes all."""
        scope = _scope()
        if scope in self.open:
            return None
        batch = self.open[scope] = Batch(scope)
        return batch

    def end(self, batch: Batch) -> None:
        """Close a batch, whoever calls this."""
        del self.open[batch.scope]

    def present(self) -> Batch | None:
        """Return the open batch of whoever calls this, if any."""
        return self.open.get(_scope())


def _scope() -> object:
    """Return what runs: an asyncio task, or else a thread."""
    try:
        return asyncio.current_task() or get_ident()
    except RuntimeError:  # no event loop runs here
        return get_ident()
