"""Worlds in which every transport is tried: a simulated network in virtual time, and sessions on loopback."""

from __future__ import annotations

import asyncio
import json
import random
import socket
import threading
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from unittest.mock import patch

from patience import PATIENCE

from mdm.runtime import VirtualClock, VirtualEventLoop
from mdm.team.transport import certificates
from mdm.team.transport.access import access_settings
from mdm.team.transport.network import Network
from mdm.team.transport.router import LARGEST
from mdm.team.transport.session import Session, _lay_over
from mdm.team.transport.settings import settings


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
            await self.until(lambda transport=transport: len(transport.live) >= len(transports))

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
    """Return a port of loopback that nobody listens on, and that was not returned before.

    It is below those that the system gives to whoever connects: by the time it is used, one of these may be taken.
    """
    while True:
        port = random.SystemRandom().randrange(10_000, 32_000)
        if port in _given:
            continue
        _given.add(port)
        with socket.socket() as one, suppress(OSError):
            one.bind(("127.0.0.1", port))
            return port


def endpoint(port=None, *, protocol="tcp"):
    return f"{protocol}/127.0.0.1:{port or free_port()}"


class Loopback:
    """Sessions on loopback, each of which connects to those made before it.

    Args:
        files: The files that agents show, by name; without them no certificates are asked for.
        agents: The agents, where there are files.
        options: Of every session.
    """

    def __init__(self, *, files=None, agents=(), **options):
        self.files = files
        self.agents = agents
        self.options = options
        self.endpoints = []
        self.made = []

    def transport(self, agent, *, shown=None, **options):
        options = {"connect": self.endpoints, "lease": 2.0, **self.options, **options}
        own = options.setdefault("listen", endpoint(protocol="tls" if self.files else "tcp"))
        if self.files:
            shown = shown or self.files[agent]
            options["configuration"] = access_settings(shown, "team", agent, self.agents)
        made = Session("team", agent, **options)
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
        """Wait for something."""
        async with asyncio.timeout(PATIENCE):
            while not condition():
                await asyncio.sleep(0.002)

    async def close(self):
        await asyncio.gather(*(transport.close() for transport in self.made))


@contextmanager
def routing(where, shown=None, agents=()):
    """Run a router of Zenoh in this process, as the page on addresses does; with what it shows, it keeps the rules."""
    import zenoh

    chosen = {
        "mode": "router",
        "listen": {"endpoints": [where]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }
    if shown is not None:
        chosen |= access_settings(shown, "team", "router", agents)
    router = zenoh.open(zenoh.Config.from_json5(json.dumps(chosen)))
    try:
        yield
    finally:
        router.close()


@contextmanager
def two_days_ago():
    """Make certificates as of two days ago: those for one day are no longer valid."""
    then = datetime.now(UTC) - timedelta(days=2)
    clock = SimpleNamespace(datetime=SimpleNamespace(now=lambda zone: then), timedelta=timedelta, UTC=UTC)
    with patch.object(certificates, "dt", clock):
        yield


class Stranger:
    """A session of Zenoh beside a team that keeps to none of its rules.

    Args:
        endpoints: Where it connects.
        configuration: Further settings of Zenoh.
    """

    def __init__(self, endpoints, configuration=None):
        import zenoh

        chosen = settings(listen=[], connect=endpoints, lease=2.0, largest=LARGEST)
        _lay_over(chosen, configuration or {})
        self.session = zenoh.open(zenoh.Config.from_json5(json.dumps(chosen)))
        self.block = zenoh.CongestionControl.BLOCK
        self.tokens = []

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        await asyncio.to_thread(self.session.close)

    def put(self, key, data):
        self.session.put(key, data, congestion_control=self.block)

    def live(self, key):
        self.tokens.append(self.session.liveliness().declare_token(key))

    def ask(self, key, data):
        return list(self.session.get(key, payload=data, timeout=PATIENCE))

    async def reach(self, robots, agent="a"):
        """Put garbage as an agent until it comes to each robot."""

        def reached():
            self.put(f"mdm/team/{agent}/beat", b"")
            return all("malformed" in robot.kinds() for robot in robots)

        async with asyncio.timeout(PATIENCE):
            while not reached():
                await asyncio.sleep(0.01)


def LOOPBACK(main, **options):  # noqa: N802 (it is a parameter of tests)
    """Run a test on sessions between the ports of this machine."""

    async def run():
        net = Loopback(**options)
        try:
            await main(net)
        finally:
            await net.close()

    before = set(threading.enumerate())
    asyncio.run(run())
    for thread in set(threading.enumerate()) - before:  # each ends when its session is closed
        thread.join(PATIENCE)
        assert not thread.is_alive(), thread.name
