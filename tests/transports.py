"""Worlds in which every transport is tried: a simulated network in virtual time, and sessions on loopback."""

from __future__ import annotations

import asyncio

from mdm.runtime import VirtualClock, VirtualEventLoop
from mdm.team.network import Network


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
