"""Processes beside the measured one: busy ones, one that puts a key by Zenoh, and one that looks at the page."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from mdm.team.transport.session import import_zenoh

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

BUSY = """
import os
starter = os.getppid()
while os.getppid() == starter:
    sum(range(10_000))
"""
LOOKER = """
import asyncio, json, sys
from mdm.views.web.client import opened

async def look():
    async with opened(sys.argv[1]) as page:
        while True:
            told = json.loads(await page.receive())
            await page.say({"say": "drawn", "cursor": told.get("cursor", 0), "close": []})

asyncio.run(look())
"""
_PUTTER = """
import sys, time, zenoh
session = zenoh.open(zenoh.Config.from_json5(sys.argv[1]))
publisher = session.declare_publisher("latency")
for _ in sys.stdin:
    publisher.put(str(time.perf_counter_ns()))
session.close()
"""


@contextmanager
def spawned(program: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a program in a process of its own, and end it.

    Args:
        program: Its text in Python; its standard input takes lines.
        arguments: Those of its command line.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", program, *arguments]
    process = subprocess.Popen(  # noqa: S603 - a program of ours
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def putter(hear: Callable[[int], None]) -> Iterator[Callable[[], None]]:
    """Have another process put a key by Zenoh; yield a function that lets it do so once.

    Args:
        hear: Called on a thread of Zenoh, with the nanoseconds of the machine's clock when the key was put.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        place = f"tcp/127.0.0.1:{free.getsockname()[1]}"

    def settings(way: str) -> str:
        alone = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
        return json.dumps({"mode": "peer", "listen": {"endpoints": []}, way: {"endpoints": [place]}, "scouting": alone})

    library = import_zenoh()
    with library.open(library.Config.from_json5(settings("listen"))) as session:
        session.declare_subscriber("latency", lambda sample: hear(int(sample.payload.to_string())))
        with spawned(_PUTTER, settings("connect")) as process:

            def put() -> None:
                assert process.stdin is not None
                process.stdin.write("\n")
                process.stdin.flush()

            yield put
