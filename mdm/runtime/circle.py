"""Circles: which actors keep a turn going that has no end, and by which messages."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdm.runtime.channel import Subscription
    from mdm.runtime.dispatcher import Dispatcher

__all__ = ["Circle"]

_SEEN = 256
_NAMED = 8


class Circle:
    """Watches some messages of a turn, and names those that lead to others without end.

    Args:
        dispatcher: Which delivers them.
    """

    def __init__(self, dispatcher: Dispatcher) -> None:
        self._dispatcher = dispatcher
        self._left = _SEEN
        self._head: Subscription[Any] | None = None
        self._length = 0
        # Who has published on which channel, and who takes what comes there, by name.
        self._edges: dict[tuple[str, str], set[str]] = {}

    def look(self) -> bool:
        """Note what the message delivered last has led to, before the next one; the turn is not cut there."""
        queue = self._dispatcher.queue
        if self._head is not None:
            # What a handler publishes stands behind all that waited by then.
            for led_to, _ in islice(queue, self._length - 1, None):
                if led_to.channel is not None:
                    self._edges.setdefault((_name(self._head), led_to.channel.name), set()).add(_name(led_to))
        self._head = queue[0][0] if queue else None
        self._length = len(queue)
        self._left -= 1
        if self._left < 0:
            self._dispatcher.watch = None
        return False

    def __str__(self) -> str:
        """Return who publishes on which channel, as far as that leads to further messages."""
        edges = dict(self._edges)
        while True:  # who takes a message and publishes nothing does not keep the turn going
            going = {who for who, _ in edges}
            on = {edge: takers for edge, takers in edges.items() if not takers.isdisjoint(going)}
            if len(on) == len(edges):
                break
            edges = on
        edges = edges or self._edges  # where each round is a turn of its own, a task leads from one to the next
        told = [f"{who} publishes on {channel!r}" for who, channel in islice(edges, _NAMED)]
        more = len(edges) - len(told)
        return ", ".join(told) + (f", and {more} more" if more > 0 else "")


def _name(subscription: Subscription[Any]) -> str:
    """Return the path of the actor whose handler takes messages; that of the program is no actor's."""
    path = getattr(subscription.actor, "path", "")
    return repr(path) if path else "a handler of the program"
