"""A simulated network: the agents of a team in one process and one clock, with losses, delays and partitions by seed.

It keeps the promises of a `Transport`, so that a program that runs on it runs between processes too. In virtual time a
run takes no time to wait for, and one seed gives one run.
"""

from __future__ import annotations

import asyncio
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from mdm.checks import is_number
from mdm.errors import ConfigError, Error
from mdm.team.transport.keys import check_name
from mdm.team.transport.router import LARGEST, Router

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mdm.runtime.time.clock import Clock
    from mdm.team.transport.transport import Priority


class Network:
    """Carries the messages of a team's agents within one process.

    Args:
        clock: Whose time; that of a runtime which runs.
        team: The team's name.
        seed: Of all chances.
        delay: From a put to its handlers, in seconds: one number, or the lowest and the highest.
        loss: The chance that a message is lost on its way to one receiver.
        duplication: The chance that it comes twice.
        reordering: The chance that a message does not wait for those put before it. The envelope then refuses what is
            overtaken by a newer one of its own key.
        lease: After so many seconds an agent that crashed, or that a partition hides, is no longer seen.

    Example::

        network = mdm.team.Network(mdm.VirtualClock(), team="rescue", seed=7, loss=0.1, delay=(0.001, 0.02))
        robot1, robot2 = network.transport("robot1"), network.transport("robot2")  # for `Team.member`
        network.partition({"robot1"}, {"robot2"})
        network.heal()
    """

    def __init__(
        self,
        clock: Clock,
        *,
        team: str = "team",
        seed: int = 0,
        delay: float | tuple[float, float] = 0.001,
        loss: float = 0.0,
        duplication: float = 0.0,
        reordering: float = 0.0,
        lease: float = 1.0,
    ) -> None:
        self.clock = clock
        self.team = check_name(team, "a team")
        self.random = Random(seed)  # noqa: S311 (chances of a simulation)
        for what, chance in (("loss", loss), ("duplication", duplication), ("reordering", reordering)):
            if not is_number(chance) or not 0 <= chance <= 1:
                raise ConfigError(f"{what} is a chance between 0 and 1, not {chance!r}")
        self.loss, self.duplication, self.reordering = loss, duplication, reordering
        low, high = delay if isinstance(delay, tuple) else (delay, delay)
        if not (is_number(low) and is_number(high) and 0 <= low <= high):
            raise ConfigError(f"the delay is a number of seconds or (lowest, highest), not {delay!r}")
        if not is_number(lease) or lease < 0:
            raise ConfigError(f"the lease is a number of seconds, not {lease!r}")
        self._delay = (low, high)
        self._lease = round(lease * 1e9)
        self._incarnations: dict[str, int] = {}
        self._open: dict[str, SimulatedTransport] = {}
        self._sides: dict[str, int] = {}
        self._arrivals: dict[tuple[str, str], int] = {}

    def transport(self, agent: str, *, largest: int = LARGEST) -> SimulatedTransport:
        """Return a transport of an agent, in a new incarnation.

        Args:
            agent: Its name.
            largest: The largest message in bytes.
        """
        check_name(agent, "an agent")
        incarnation = self._incarnations[agent] = self._incarnations.get(agent, 0) + 1
        return SimulatedTransport(self, agent, incarnation, largest)

    def partition(self, *sides: Iterable[str]) -> None:
        """Let messages pass within each side alone; agents that are in none are together on one more side."""
        self._sides = {agent: number for number, side in enumerate(sides, 1) for agent in side}
        self._changed(self._lease)

    def heal(self) -> None:
        """Let messages pass between all agents again."""
        self._sides = {}
        self._changed(0)

    def crash(self, agent: str) -> None:
        """End an agent's transport without a farewell: nothing more comes from it or to it.

        Raises:
            Error: If no such agent is open.
        """
        transport = self._open.pop(agent, None)
        if transport is None:
            raise Error(f"agent {agent!r} is not open; open are {', '.join(self._open) or 'none'}")
        transport.state = "closed"
        self._changed(self._lease)

    def connected(self, first: str, second: str) -> bool:
        """Whether messages pass between two agents."""
        return first in self._open and second in self._open and self.together(first, second)

    def together(self, first: str, second: str) -> bool:
        """Whether two agents are on the same side."""
        return self._sides.get(first, 0) == self._sides.get(second, 0)

    def join(self, transport: SimulatedTransport) -> None:
        """Let a transport take part.

        Raises:
            Error: If its agent is live already.
        """
        if transport.agent in self._open:
            raise Error(
                f"an agent {transport.agent!r} of team {self.team!r} is live already: each has a name of its own"
            )
        self._open[transport.agent] = transport
        transport.state = "open"
        transport.look()
        self._changed(0)

    def leave(self, transport: SimulatedTransport) -> None:
        """Let a transport take part no more; each of the others hears of it behind its last messages."""
        del self._open[transport.agent]
        for receiver in tuple(self._open.values()):
            if self.together(transport.agent, receiver.agent):
                receiver.leaving[transport.agent] = transport.incarnation
            arrival = self._behind(transport.agent, receiver, self.clock.now() + self._draw())
            self.clock.call_at(arrival, partial(receiver.see_end, transport.agent, transport.incarnation))

    def _changed(self, after: int) -> None:
        """Let every agent look who is live: as soon as word of it comes, or once a lease is over."""
        for transport in tuple(self._open.values()):
            self.clock.call_at(self.clock.now() + after + self._draw(), transport.look)

    def _behind(self, sender: str, receiver: SimulatedTransport, arrival: int) -> int:
        """Return when that comes which would come then, behind all that went the same way before."""
        way = (sender, receiver.agent)
        self._arrivals[way] = max(arrival, self._arrivals.get(way, 0))
        return self._arrivals[way]

    def _draw(self) -> int:
        return round(self.random.uniform(*self._delay) * 1e9)

    def live(self, agent: str) -> dict[str, int]:
        """Return the agents that one can reach, and itself, with their incarnations."""
        return {
            other: transport.incarnation
            for other, transport in self._open.items()
            if other == agent or self.connected(agent, other)
        }

    def others(self, agent: str) -> list[SimulatedTransport]:
        """Return the transports that are open, without that of an agent itself."""
        return [transport for name, transport in sorted(self._open.items()) if name != agent]

    def send(self, sender: str, receiver: SimulatedTransport, deliver: Callable[[], None]) -> None:
        """Let a message take its way, or its chance to get lost."""
        if not self.connected(sender, receiver.agent) or self.random.random() < self.loss:
            return
        times = 2 if self.random.random() < self.duplication else 1
        for _ in range(times):
            arrival = self.clock.now() + self._draw()
            if not self.random.random() < self.reordering:
                arrival = self._behind(sender, receiver, arrival)
            self.clock.call_at(arrival, deliver)


class SimulatedTransport(Router):
    """An agent's transport on a simulated `Network`; made by `Network.transport`."""

    def __init__(self, network: Network, agent: str, incarnation: int, largest: int) -> None:
        super().__init__(network.team, agent, incarnation, network.clock.now, largest=largest)
        self._network = network
        # Agents that have left, with their incarnations, while word of it is on its way here.
        self.leaving: dict[str, int] = {}

    def _later(self, seconds: float, callback: Callable[[], None]) -> None:
        clock = self._network.clock
        clock.call_at(clock.now() + round(seconds * 1e9), callback)

    async def open(self) -> None:
        """Take part."""
        self._check_new()
        self._network.join(self)

    async def close(self) -> None:
        """Leave."""
        if self.state == "open":
            self._network.leave(self)
        self.state = "closed"

    def look(self) -> None:
        """See who is live."""
        if self.state == "open":
            left = {agent: life for agent, life in self.leaving.items() if self._network.together(self.agent, agent)}
            self.see(self._network.live(self.agent) | left)

    def see_end(self, agent: str, incarnation: int) -> None:
        """Note that an agent has left."""
        if self.leaving.get(agent) == incarnation:
            del self.leaving[agent]
        self.look()

    def put(self, key: str, body: bytes, *, priority: Priority = "value") -> bool:
        """Send to all who subscribed."""
        if (self.state != "open" or key not in self.packer.sent) and self._is_closed(key):
            return False
        data = self.packer.pack(key, body, step=priority == "step")
        for receiver in self._network.others(self.agent):
            if receiver.wants(key):
                self._network.send(self.agent, receiver, partial(receiver.arrive, key, data))
        return True

    def arrive(self, key: str, data: bytes) -> None:
        """Hand a message on that took its way."""
        if self.state == "open":
            self.deliver(key, data, self._network.clock.now())

    async def ask(self, expression: str, body: bytes = b"", *, timeout: float = 1.0) -> dict[str, bytes]:  # noqa: ASYNC109
        """Ask all who serve the keys of an expression; return the answers by agent."""
        question = self._question(expression, body)
        return await _Inquiry(self._network, self, question).answers(expression, timeout)


class _Inquiry:
    """A question on its way to all who answer it, and their answers on their way back."""

    def __init__(self, network: Network, asker: SimulatedTransport, question: bytes) -> None:
        self._network = network
        self._asker = asker
        self._question = question
        self._began = network.clock.now()
        self._awaited: set[str] = set()
        self._answers: dict[str, bytes] = {}
        self._done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def answers(self, expression: str, timeout: float) -> dict[str, bytes]:  # noqa: ASYNC109
        """Return the answers that came in so many seconds."""
        network, asker = self._network, self._asker
        asked = [
            (other, key)
            for other in network.others(asker.agent)
            if network.connected(asker.agent, other.agent)
            for key in other.served(expression)
        ]
        self._awaited.update(key for _, key in asked)
        for other, key in asked:
            network.send(asker.agent, other, partial(self._arrive, other, key))
        if asked:
            timer = network.clock.call_at(self._began + round(timeout * 1e9), self._end)
            try:
                await self._done
            finally:
                timer.cancel()
        return self._answers

    def _arrive(self, other: SimulatedTransport, key: str) -> None:
        answer = other.answer(key, self._question) if other.state == "open" else None
        if answer is not None:
            data = other.packer.seal(answer)
            self._network.send(other.agent, self._asker, partial(self._receive, key, data))

    def _receive(self, key: str, data: bytes) -> None:
        if self._done.done():
            return
        answer = self._asker.answered(key, data, (self._network.clock.now() - self._began) / 1e9)
        if answer is not None:
            self._answers[answer.owner] = answer.body
        self._awaited.discard(key)
        if not self._awaited:
            self._end()

    def _end(self) -> None:
        if not self._done.done():
            self._done.set_result(None)
