"""What a team's messages are measured against: the same bytes between processes without mdm."""

from __future__ import annotations

import asyncio
import json
import os
import threading
import time
from collections import defaultdict, deque
from functools import partial
from itertools import pairwise
from typing import Any

import msgspec
import zenoh

from mdm.team.transport.settings import settings

__all__ = ["Bare", "Tcp"]

BODY = bytes(64)
now = time.monotonic

_encode = msgspec.msgpack.encode
_decode = msgspec.msgpack.decode


class Tcp(asyncio.Protocol):
    """A ping-pong over asyncio's TCP: the first agent answers, the second asks."""

    def __init__(self, number: int, port: int) -> None:
        self.number, self.port = number, port
        self.pong: asyncio.Future[None] | None = None
        self.transport: Any = None
        self.server: Any = None

    async def open(self) -> None:
        """Listen, or connect."""
        loop = asyncio.get_running_loop()
        if self.number == 0:
            self.server = await loop.create_server(lambda: self, "127.0.0.1", self.port)
        while self.number == 1 and self.transport is None:
            try:
                await loop.create_connection(lambda: self, "127.0.0.1", self.port)
            except OSError:
                await asyncio.sleep(0.02)

    def connection_made(self, transport: Any) -> None:
        """Keep the transport."""
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        """Answer, or tell who waits."""
        if self.number == 0:
            self.transport.write(data)
        elif self.pong is not None:
            self.pong.set_result(None)

    async def round_trips(self, count: int) -> list[float]:
        """Return the seconds of so many."""
        found = []
        for _ in range(count):
            self.pong = asyncio.get_running_loop().create_future()
            began = now()
            self.transport.write(BODY)
            await self.pong
            found.append(now() - began)
        return found

    def close(self) -> None:
        """End."""
        for one in (self.transport, self.server):
            if one is not None:
                one.close()


class Bare:
    """Zenoh without a team: its callbacks in their thread, or on the loop, woken by eventfd."""

    def __init__(self, number: int, ports: list[int], *, lease: float) -> None:
        self.number, self.size = number, len(ports)
        endpoints = [f"tcp/127.0.0.1:{port}" for port in ports]
        given = settings(listen=[endpoints[number]], connect=endpoints[:number], lease=lease, largest=1 << 20)
        self.configuration = zenoh.Config.from_json5(json.dumps(given))
        self.items: deque[tuple[str, bytes]] = deque()
        self.armed = False
        self.met: set[int] = set()
        self.heard: dict[int, int] = defaultdict(int)
        self.more: asyncio.Future[None] | None = None
        self.step = 0

    async def open(self) -> None:
        """Connect with the others."""
        loop = asyncio.get_running_loop()
        self.session = await loop.run_in_executor(None, zenoh.open, self.configuration)
        self.eventfd = os.eventfd(0, os.EFD_NONBLOCK)
        loop.add_reader(self.eventfd, self._drain)
        block = zenoh.CongestionControl.BLOCK
        to = 1 - self.number if self.number < 2 else None
        self.publishers = {
            key: self.session.declare_publisher(f"bare/{key}", congestion_control=block)
            for key in (f"loop/{to}", f"thread/{to}", "meet", "step")
        }
        self.returned = threading.Event()
        for key in (f"loop/{self.number}", "meet", "step"):
            self.session.declare_subscriber(
                f"bare/{key}", partial(self._put, key.partition("/")[0]), allowed_origin=zenoh.Locality.REMOTE
            )
        self.answer = self._answer() if self.number == 0 else self._next
        self.session.declare_subscriber(
            f"bare/thread/{self.number}", lambda sample: self.answer(sample.payload.to_bytes())
        )
        meet = self.publishers["meet"]
        while len(self.met) < self.size - 1:
            meet.put(_encode((self.number, 0)))
            await asyncio.sleep(0.05)
        for _ in range(3):  # for those who have not heard it yet
            meet.put(_encode((self.number, 0)))
            await asyncio.sleep(0.05)

    def _answer(self) -> Any:
        return self.publishers[f"thread/{1 - self.number}"].put

    def _put(self, key: str, sample: zenoh.Sample) -> None:
        self.items.append((key, sample.payload.to_bytes()))
        if not self.armed:
            self.armed = True
            os.eventfd_write(self.eventfd, 1)

    def _drain(self) -> None:
        os.eventfd_read(self.eventfd)
        self.armed = False
        while self.items:
            key, body = self.items.popleft()
            if key == "loop":
                if self.number == 0:
                    self.publishers["loop/1"].put(body)
                elif self.more is not None:
                    self.more.set_result(None)
                continue
            number, step = _decode(body)
            if key == "meet":
                self.met.add(number)
                continue
            self.heard[step] += 1
            if step == self.step and self.heard[step] == self.size - 1 and self.more is not None:
                self.more.set_result(None)

    async def round_trips(self, count: int, way: str) -> list[float]:
        """Return the seconds of so many, by the callback's thread or by the loop."""
        if "callback" in way:
            return await asyncio.to_thread(self._by_callbacks, count)
        found, put = [], self.publishers["loop/0"].put
        for _ in range(count):
            self.more = asyncio.get_running_loop().create_future()
            began = now()
            put(BODY)
            await self.more
            found.append(now() - began)
        self.more = None
        return found

    def _by_callbacks(self, count: int) -> list[float]:
        self.times: list[float] = [now()]
        self.count = count
        self.returned.clear()
        self.publishers["thread/0"].put(BODY)
        self.returned.wait()
        return [after - before for before, after in pairwise(self.times)]

    def _next(self, body: bytes) -> None:
        self.times.append(now())
        if len(self.times) <= self.count:
            self.publishers["thread/0"].put(body)
        else:
            self.returned.set()

    async def steps(self, count: int) -> list[float]:
        """Say something at each step, and wait for what all others say; return the seconds between."""
        ends, put = [], self.publishers["step"].put
        for _ in range(count):
            self.step += 1
            put(_encode((self.number, self.step)))
            if self.heard[self.step] < self.size - 1:
                self.more = asyncio.get_running_loop().create_future()
                await self.more
                self.more = None
            del self.heard[self.step]
            ends.append(now())
        return [after - before for before, after in pairwise(ends)]

    async def close(self) -> None:
        """End."""
        asyncio.get_running_loop().remove_reader(self.eventfd)
        await asyncio.to_thread(self.session.close)
        os.close(self.eventfd)
