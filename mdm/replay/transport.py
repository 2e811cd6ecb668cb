"""The transport of a replay: it hands on what the record has, and what it sends goes to agents replayed with it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from mdm.runtime.statistics import Latencies
from mdm.team.transport.transport import PROTOCOL, Sample, TransportStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mdm.replay.exchange import Exchange, Life, Otherwise
    from mdm.stimuli import Asked, Received
    from mdm.team.transport.transport import Priority

__all__ = ["ReplayTransport"]


class ReplayTransport:
    """Carries what a record has to one agent.

    Args:
        agent: The agent.
        incarnation: The number of its recorded life.
        unsent: The numbers of its messages that were held back.
        protocol: The version of what it said.

    Attributes:
        exchange: What brings its messages to other agents that are replayed together with it, where there is one.
    """

    def __init__(
        self, agent: str, incarnation: int, unsent: frozenset[int] = frozenset(), protocol: int = PROTOCOL
    ) -> None:
        self.agent = agent
        self.incarnation = incarnation
        self.protocol = protocol
        self._unsent = unsent
        self._puts = 0
        self.exchange: Exchange | Otherwise | None = None
        self._answering: dict[str, Callable[[bytes], bytes]] = {}
        self._handlers: dict[str, Callable[[Sample], None]] = {}
        self._watchers: list[Callable[[Mapping[str, int]], None]] = []
        self._opened = asyncio.Event()

    @property
    def life(self) -> Life:
        """The agent, and the number of its recorded life."""
        return self.agent, self.incarnation

    async def open(self) -> None:
        """Wait until the record's link was open."""
        await self._opened.wait()

    async def close(self) -> None:
        """Leave."""

    def release(self) -> None:
        """Let it be open."""
        self._opened.set()

    def hears(self, expression: str) -> bool:
        """Whether anything listens to the keys of an expression."""
        return expression in self._handlers

    def receive(self, received: Received) -> None:
        """Hand a recorded message on."""
        handler = self._handlers.get(received.expression)
        if handler is not None:
            sample = Sample(received.key, received.owner, received.incarnation, received.body, received.sent)
            handler(sample)

    def see(self, live: Mapping[str, int]) -> None:
        """Tell which agents were live."""
        for watcher in self._watchers:
            watcher(live)

    def put(self, key: str, body: bytes, *, priority: Priority = "value") -> bool:
        """Send to agents that are replayed together with this one; return whether it was sent then."""
        self._puts += 1
        if self._puts in self._unsent:
            return False
        if self.exchange is not None:
            self.exchange.send(*self.life, key, bytes(body))
        return True

    def subscribe(self, expression: str, handler: Callable[[Sample], None]) -> None:
        """Have a handler called with each recorded message under the keys of an expression."""
        self._handlers[expression] = handler

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        """Have a function called with each recorded request under a key; nobody hears the answer."""
        self._answering[key] = answer

    def serves(self, key: str) -> bool:
        """Whether requests under a key are answered."""
        return key in self._answering

    def request(self, asked: Asked) -> None:
        """Hand a recorded request on."""
        answer = self._answering.get(asked.key)
        if answer is not None:
            told = answer(asked.body)
            if self.exchange is not None:
                self.exchange.send(*self.life, asked.key, bytes(told), answer=True)

    async def ask(self, expression: str, body: bytes = b"", *, timeout: float = 1.0) -> dict[str, bytes]:  # noqa: ASYNC109
        """Wait for ever: answers that count are in the record by themselves."""
        await asyncio.get_running_loop().create_future()
        return {}

    def watch(self, handler: Callable[[Mapping[str, int]], None]) -> None:
        """Have a handler called with the live agents."""
        self._watchers.append(handler)

    def supervise(self, failed: Callable[[BaseException], None], report: Callable[[str, str], None]) -> None:
        """Report nothing."""

    def refuse(self, sender: str, reason: str) -> None:
        """Take note of nothing."""

    def statistics(self) -> TransportStatistics:
        """Return no counts."""
        return TransportStatistics({}, {}, {}, {}, Latencies().snapshot(), {})
