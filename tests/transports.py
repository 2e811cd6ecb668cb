"""Worlds in which every transport is tried: a simulated network in virtual time, and sessions on loopback."""

from __future__ import annotations

import asyncio
import socket

from mdm.runtime import VirtualClock, VirtualEventLoop
from mdm.team.transport.network import Network
from mdm.team.transport.session import Session


def key(agent, channel="c"):
    return f"mdm/team/{agent}/e/{channel}"


class Simulated:
    """A network in virtual time."""

    def __init__(self, clock, **options):
        self.network = Network(clock, **options)
        self.transport = self.network.transport
        self.opened = []

    async def open(self, *transports):
        """Open transports, and wait until they see each other."""
        self.opened += transports
        for transport in transports:
            await transport.open()
        for transport in transports:
            await self.until(lambda transport=transport: len(transport.router.live) >= len(transports))

    async def until(self, condition):
        """Wait for something at most half a minute."""
        async with asyncio.timeout(30):
            while not condition():
                await asyncio.sleep(0.001)

    async def close(self):
        for transport in self.opened:
            await transport.close()


def SIMULATED(main, **options):  # noqa: N802 (it is a parameter of tests)
    """Run a test on a network in virtual time."""

    async def run():
        clock = VirtualClock()
        clock.open(asyncio.get_running_loop())
        net = Simulated(clock, **options)
        try:
            await main(net)
        finally:
            await net.close()
            clock.close()

    with asyncio.Runner(loop_factory=VirtualEventLoop) as runner:
        runner.run(run())


_given = set()


def free_port():
    """Return a port of loopback that nobody listens on, and that was not returned before."""
    while True:
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            port = one.getsockname()[1]
        if port not in _given:
            _given.add(port)
            return port


def endpoint(port=None):
    return f"tcp/127.0.0.1:{port or free_port()}"


class Loopback:
    """Sessions on loopback, each of which connects to those made before it."""

    def __init__(self, **options):
        self.options = options
        self.endpoints = []
        self.made = []

    def transport(self, agent, **options):
        own = endpoint()
        made = Session("team", agent, listen=own, connect=self.endpoints, **{"lease": 2.0, **self.options, **options})
        self.endpoints = [*self.endpoints, own]
        self.made.append(made)
        return made

    async def open(self, *transports):
        """Open transports, and wait until they see each other."""
        await asyncio.gather(*(transport.open() for transport in transports))
        names = {transport.agent for transport in transports}
        for transport in transports:
            seen = []
            transport.watch(seen.append)
            await self.until(lambda seen=seen: names <= seen[-1].keys())

    async def until(self, condition):
        """Wait for something at most half a minute."""
        async with asyncio.timeout(30):
            while not condition():
                await asyncio.sleep(0.002)

    async def close(self):
        await asyncio.gather(*(transport.close() for transport in self.made))


def LOOPBACK(main, **options):  # noqa: N802 (it is a parameter of tests)
    """Run a test on sessions between the ports of this machine."""

    async def run():
        net = Loopback(**options)
        try:
            await main(net)
        finally:
            await net.close()

    asyncio.run(run())
