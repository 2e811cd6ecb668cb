"""The mailbox: messages of other threads that the event loop has not taken yet. It is bounded, however long that takes.

A thread appends, and wakes the loop only where nobody has: thousands of messages cost one wake-up. Where more wait
than the bound, of each key the newest value stays; then values go, the oldest first, and last messages of agreed steps.
"""

from __future__ import annotations

import os
from collections import Counter, deque
from contextlib import suppress
from threading import Lock
from time import monotonic_ns
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

__all__ = ["Mailbox"]

Item: TypeAlias = "tuple[str | None, str, Any]"
"""The carrier of a message, its key and its bytes; or None, nothing, and a function to be called."""

_BOUND = 8192
_LARGE = 4096
_MOST_BYTES = 64 << 20
_ROUND = 32
_SLICE = 5_000_000
_WINDOW = 1_000_000
_PAUSE = 0.001
_MANY = 50_000


class Mailbox:
    """Hands messages of threads to the event loop, in order.

    Args:
        loop: The running event loop.
        deliver: Called on the loop with a message's key, its bytes, the time, and its carrier.
        lost: Called on the loop with a key, and how many of its messages were too many.
        now: The time in nanoseconds.
        urgent: Whether a message is one that is given up last.
        failed: Called with the error of a posted call.
        bound: How many messages may wait.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        deliver: Callable[[str, bytes, int, str], None],
        lost: Callable[[str, int], None],
        *,
        now: Callable[[], int],
        urgent: Callable[[bytes], bool],
        failed: Callable[[BaseException], None],
        bound: int = _BOUND,
    ) -> None:
        self.items: deque[Item] = deque()
        self.armed = False
        self._loop = loop
        self._deliver = deliver
        self._lost = lost
        self._now = now
        self._urgent = urgent
        self._failed = failed
        self._bound = bound
        self._large = 0
        self._since = self._taken = 0
        self._crowd = False
        self._pause: asyncio.Handle | None = None
        self._losses: Counter[str] = Counter()
        self._lock = Lock()
        self._closed = False
        self._descriptor: int | None = None
        if hasattr(os, "eventfd"):
            self._descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            try:
                loop.add_reader(self._descriptor, self._woken)
            except NotImplementedError:
                os.close(self._descriptor)
                self._descriptor = None

    def put(self, carrier: str, key: str, data: bytes) -> None:
        """Let a message wait; from any thread."""
        items = self.items
        items.append((carrier, key, data))
        if len(data) > _LARGE or len(items) > self._bound:
            size = len(data)
            with self._lock:
                if size > _LARGE:
                    self._large += size
                if len(self.items) > self._bound or self._large > _MOST_BYTES:
                    self._condense()
        if not self.armed:
            self._arm()

    def post(self, call: Callable[[], None]) -> None:
        """Have a function called on the loop, after the pending messages; from any thread."""
        self.items.append((None, "", call))
        if not self.armed:
            self._arm()

    def offer(self, key: str, call: Callable[[], None]) -> bool:
        """Have something called on the loop as `post` does, unless too much waits; return whether it will be."""
        if len(self.items) < self._bound:
            self.post(call)
            return True
        with self._lock:
            self._losses[key] += 1
        return False

    def _arm(self) -> None:
        self.armed = True
        with self._lock:
            if self._closed:
                return
            if self._descriptor is not None:
                os.eventfd_write(self._descriptor, 1)
            else:
                with suppress(RuntimeError):  # the loop is closed
                    self._loop.call_soon_threadsafe(self._drain)

    def _condense(self) -> None:
        """Keep half of the messages that may wait: first all that is urgent, then the newest value of each key."""
        waiting = []
        with suppress(IndexError):
            while True:
                waiting.append(self.items.popleft())
        room, space = self._bound // 2, _MOST_BYTES // 2
        kept: list[Item] = []
        values: list[Item] = []
        seen: set[str] = set()
        order = {id(item): place for place, item in enumerate(waiting)}
        for item in reversed(waiting):
            if item[0] is None or self._urgent(item[2]):
                kept.append(item)
            elif item[1] not in seen:
                seen.add(item[1])
                values.append(item)
        chosen = []
        for item in (*kept, *values):
            size = 0 if item[0] is None else len(item[2])
            if item[0] is None or (room > 0 and space >= size):
                room -= 1
                space -= size
                chosen.append(item)
        chosen.sort(key=lambda item: order[id(item)])
        remaining = {id(item) for item in chosen}
        self._losses.update(item[1] for item in waiting if id(item) not in remaining)
        self._large = sum(len(item[2]) for item in chosen if item[0] is not None and len(item[2]) > _LARGE)
        self.items.extendleft(reversed(chosen))

    def _woken(self) -> None:
        descriptor = self._descriptor
        if descriptor is None:
            return
        try:  # noqa: SIM105 - suppress() takes longer than to read, at each wake-up
            os.eventfd_read(descriptor)
        except BlockingIOError:
            pass
        if self._pause is None:
            self._drain()

    def _drain(self) -> None:
        if self._closed:
            return
        paused, self._pause = self._pause is not None, None
        if not paused:
            self.armed = False  # before the first is taken: what comes from now on wakes the loop anew
        if self._losses:
            self._report_losses()
        began = monotonic_ns()
        if began - self._since >= _WINDOW:
            self._crowd = self._taken * 1_000_000_000 > _MANY * (began - self._since)
            self._since, self._taken = began, 0
        if not self._hand_on(began + _SLICE):
            return
        if self.items:  # it took too long: others of the loop have their turn
            self.armed = True
            self._pause = self._loop.call_soon(self._drain)
        elif self._crowd:
            # So many come that a wake-up for every few of them would cost more than they do: look again a little later.
            self.armed = True
            self._pause = self._loop.call_later(_PAUSE, self._drain)
        elif paused:
            self.armed = False
            if self.items:
                self._arm()

    def _hand_on(self, until: int) -> bool:
        """Hand on the pending messages, as far as a time allows; return whether the mailbox is still open."""
        items, deliver = self.items, self._deliver
        while not self._closed:
            now = self._now()
            for number in range(_ROUND):
                try:
                    carrier, key, data = items.popleft()
                except IndexError:
                    self._taken += number
                    return not self._closed
                if carrier is None:
                    self._call(data)
                    continue
                if len(data) > _LARGE:
                    with self._lock:
                        self._large -= len(data)
                deliver(key, data, now, carrier)
            self._taken += _ROUND
            if monotonic_ns() > until:
                break
        return not self._closed

    def _report_losses(self) -> None:
        with self._lock:
            losses, self._losses = self._losses, Counter()
        for key, count in losses.items():
            self._lost(key, count)

    def _call(self, call: Callable[[], None]) -> None:
        try:
            call()
        except BaseException as error:
            self._failed(error)

    def close(self) -> None:
        """Hand on nothing more, and give the descriptor back."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            descriptor, self._descriptor = self._descriptor, None
        if self._pause is not None:
            self._pause.cancel()
        if descriptor is not None:
            if not self._loop.is_closed():
                self._loop.remove_reader(descriptor)
            os.close(descriptor)
        self.items.clear()
