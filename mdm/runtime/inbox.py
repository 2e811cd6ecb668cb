"""The inbox: what other threads said and the event loop has not taken yet. It is bounded, however long that takes."""

from __future__ import annotations

from collections import Counter, OrderedDict
from threading import RLock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Hashable

    from mdm.runtime.channel import Channel

__all__ = ["Inbox"]


class Inbox:
    """Messages in the order in which they came, from any thread.

    A message that a channel says is superseded by the newer one gives way to it, unless one that cannot be superseded
    came between them, such as an event: what held at an event stays told before it. Each channel may have as many
    waiting as the bound. Of what is more, messages that can be superseded become one, and others are lost.

    Args:
        bound: How many messages of a channel may wait.
    """

    def __init__(self, bound: int = 2048) -> None:
        self.bound = bound
        self.replaced = 0
        self.lost = 0
        self._rests: dict[Channel[Any], int] = {}
        self._waiting: OrderedDict[Hashable, tuple[Channel[Any], Any]] = OrderedDict()
        self._counts: dict[Channel[Any], int] = {}
        self._losses: Counter[Channel[Any]] = Counter()
        self._number = 0
        # One that its own thread may take again: a signal's handler may set a sensor while another is being set.
        self._lock = RLock()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, channel: Channel[Any], message: object) -> None:
        """Let a message wait."""
        supersedes = channel.supersedes
        subject = None if supersedes is None else supersedes(message)
        with self._lock:
            count = self._counts.get(channel, 0)
            full = count >= self.bound
            if subject is None and full:
                self._losses[channel] += 1
                self.lost += 1
                return
            if full:
                place: Hashable = self._rests.get(channel)
                if place is None:
                    place = self._rests[channel] = self._next()
                elif (rest := self._waiting.get(place)) is not None:
                    message = channel.merge(rest[1], message)
            else:
                if self._rests:
                    self._rests.pop(channel, None)
                place = self._next() if subject is None else (channel, subject, self._number)
            if self._waiting and self._waiting.pop(place, None) is not None:
                count -= 1
                self.replaced += 1
            self._waiting[place] = (channel, message)
            self._counts[channel] = count + 1

    def _next(self) -> int:
        self._number += 1
        return self._number

    def take(self) -> tuple[Channel[Any], Any] | None:
        """Return the message that came first, and wait with it no longer; None where none waits."""
        with self._lock:
            if not self._waiting:
                return None
            _, (channel, message) = self._waiting.popitem(last=False)
            count = self._counts.pop(channel) - 1
            if count:
                self._counts[channel] = count
            return channel, message

    def losses(self) -> Counter[Channel[Any]]:
        """Return how many messages of which channels were lost since this was last asked."""
        if not self._losses:
            return self._losses
        with self._lock:
            losses, self._losses = self._losses, Counter()
            return losses
