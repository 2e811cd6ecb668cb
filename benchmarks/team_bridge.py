"""How many small messages a second of another process come into the runtime, against a bare Zenoh callback that counts.

The sender puts messages in their envelopes, made before, as fast as it can. Each round has every receiver once.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import statistics
import time
from typing import TYPE_CHECKING, Any

import zenoh
import zenoh.handlers
from measurement import free_port, parser, report, table

import mdm
from mdm.messages import Tick
from mdm.team.transport.router import Packer
from mdm.team.transport.session import Session
from mdm.team.transport.settings import settings

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection

KEY = "mdm/team/sender/robot/position"
BODY = bytes(64)


def configuration(listen: list[str], connect: list[str]) -> zenoh.Config:
    """Return what a session of the team would use."""
    return zenoh.Config.from_json5(json.dumps(settings(listen=listen, connect=connect, lease=10, largest=1 << 20)))


def send(listen: str, count: int, orders: Connection) -> None:
    """Put as many messages as are ordered, whenever they are; answer with the seconds that it took."""
    with zenoh.open(configuration([listen], [])) as session:
        publisher = session.declare_publisher(KEY, congestion_control=zenoh.CongestionControl.BLOCK)
        # As sessions do, to have their keys known to receivers.
        session.declare_queryable(KEY, zenoh.handlers.Callback(lambda query: query.drop(), indirect=False))
        life = 0
        orders.send("ready")
        while (rate := orders.recv()) is not None:
            life += 1
            packer = Packer("sender", life, time.time_ns)
            messages = [packer.pack(KEY, BODY) for _ in range(count)]
            while not publisher.matching_status.matching:
                time.sleep(0.001)
            put = publisher.put
            began = time.perf_counter()
            for first in range(0, count, 300):
                while rate and time.perf_counter() - began < first / rate:
                    pass
                for message in messages[first : first + 300]:
                    put(message)
            orders.send(time.perf_counter() - began)


class Rate:
    """Counts, and knows when the last came."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.taken = 0
        self.first = self.last = 0.0

    async def wait(self) -> None:
        """Wait until all have come, or none comes any more."""
        before = -1
        while self.taken < self.count and (self.taken == 0 or self.taken != before):
            before = self.taken
            for _ in range(20):
                if self.taken < self.count:
                    await asyncio.sleep(0.05)

    def seconds(self) -> float:
        """Return the time from the first to the last."""
        return self.last - self.first

    def take(self, _: object = None) -> None:
        """Count one; the time is read seldom, to cost nothing."""
        self.taken += 1
        if self.taken == 1:
            self.first = time.perf_counter()
        if not self.taken % 64 or self.taken >= self.count:
            self.last = time.perf_counter()


async def bare(rate: Rate, sender: str, own: str, ready: Callable[[], None]) -> int:
    """A Zenoh callback that counts, in its own thread."""
    with zenoh.open(configuration([own], [sender])) as session:
        session.declare_subscriber(KEY, rate.take)
        ready()
        await rate.wait()
    return 0


async def handler(rate: Rate, sender: str, own: str, ready: Callable[[], None]) -> int:
    """A handler of a session, on the event loop: what comes is checked, and out of its envelope."""
    session = Session("team", "receiver", listen=own, connect=[sender])
    session.subscribe("mdm/team/**", rate.take)
    await session.open()
    ready()
    await rate.wait()
    await session.close()
    return session.statistics().dropped.get("overflow", 0)


async def channel(rate: Rate, sender: str, own: str, ready: Callable[[], None]) -> int:
    """A handler that publishes each message on a channel, to which an actor listens: a turn each."""
    async with mdm.Runtime(log=None) as runtime:
        listener = mdm.Actor("listener")
        await runtime.start(listener)
        into = runtime.channel("position", Tick)
        listener.subscribe(into, rate.take)
        session = Session("team", "receiver", listen=own, connect=[sender])
        session.subscribe("mdm/team/**", lambda sample: into.publish(Tick(sample.time, 0, 0, 0)))
        await session.open()
        ready()
        await rate.wait()
        await session.close()
        return session.statistics().dropped.get("overflow", 0)


RECEIVERS = {"bare Zenoh callback": bare, "session: a handler": handler, "session: a channel": channel}


def main() -> None:
    """Measure, print and write."""
    options = parser(__doc__ or "").parse_args()
    count, rounds = (5_000, 1) if options.quick else (300_000, 5)
    sender, own = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    context = multiprocessing.get_context("spawn")
    orders, theirs = context.Pipe()
    process = context.Process(target=send, args=(sender, count, theirs))
    process.start()
    orders.recv()
    measured: dict[tuple[str, str], list[dict[str, float]]] = {}
    for _ in range(rounds):
        for pace, given in (("as fast as it can", 0), ("300,000 a second", 300_000)):
            for name, receive in RECEIVERS.items():
                rate = Rate(count)
                overflow = asyncio.run(receive(rate, sender, own, lambda given=given: orders.send(given)))  # type: ignore[misc]
                sent = orders.recv()
                measured.setdefault((pace, name), []).append(
                    {"rate": rate.taken / max(rate.seconds(), 1e-9), "sent": count / sent, "overflow": overflow / count}
                )
    orders.send(None)
    process.join()
    rows: list[dict[str, Any]] = []
    for (pace, name), results in measured.items():
        middle = {what: statistics.median(result[what] for result in results) for what in results[0]}
        floor = statistics.median(result["rate"] for result in measured[pace, "bare Zenoh callback"])
        rows.append(
            {
                "sender": pace,
                "receiver": name,
                "taken a second": round(middle["rate"]),
                "of bare": round(middle["rate"] / floor, 2),
                "sent a second": round(middle["sent"]),
                "superseded": f"{middle['overflow']:.1%}",
            }
        )
    table("Messages of 64 bytes from another process into the runtime (medians)", rows)
    report("team_bridge", {"bridge": rows}, options.output)


if __name__ == "__main__":
    main()
