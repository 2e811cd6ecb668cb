"""Opens and closes members of teams again and again, in order and otherwise; prints what each round leaves, as JSON.

Its argument is the number of rounds.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import socket
import sys
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path

from team_robots import Robot, over_beliefs, started
from teams import team as random_team
from transports import Loopback, endpoint

import mdm
from mdm.runtime import ActorFailure

TEAM = mdm.Team("team", ["a", "b"], period=0.05, lease=0.5)
BUILD = over_beliefs(random_team(7, agents=2))


async def decide(runtime, net):
    """Two agents decide, and end in order."""
    robots = await started(runtime, TEAM, net, BUILD)
    await net.until(lambda: all(len(robot.commits) >= 2 for robot in robots))


async def fail(runtime, net):
    """One fails while they decide."""
    robots = await started(runtime, TEAM, net, BUILD)
    await net.until(lambda: robots[1].commits)
    robots[1].ensemble.control.fail(RuntimeError("a fault"))
    await asyncio.sleep(30)


async def used(runtime, net):
    """A port is used."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        net.options["listen"] = endpoint(taken.getsockname()[1])
        await Robot(TEAM, "a", net, BUILD).start(runtime)
        await asyncio.sleep(30)


async def leave(runtime, net):
    """One ends while its session opens, and nobody is where it looks for others."""
    net.endpoints.append(endpoint())
    await Robot(TEAM, "b", net, BUILD).start(runtime)
    await asyncio.sleep(0.01)


async def twice(runtime, net):
    """A second process has the name of one that lives."""
    net.options["lease"] = 1.0  # for so long a busy machine may take to answer who is there
    first = net.transport("b")
    await first.open()
    await Robot(TEAM, "b", net, BUILD).start(runtime)
    await asyncio.sleep(30)


def left():
    """Return the threads, files and child processes that this process has."""
    for thread in threading.enumerate():  # one that opens a session may take a moment to see that it is closed
        if thread is not threading.current_thread():
            thread.join(30)
    gc.collect()
    files = Counter()
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            files[descriptor.readlink().name.split(":")[0]] += 1
    return {
        "threads": sorted(thread.name for thread in threading.enumerate()),
        "native": len(list(Path("/proc/self/task").iterdir())),
        "files": dict(files),
        "children": Path(f"/proc/self/task/{os.getpid()}/children").read_text().split(),
        "shared": [line for line in Path("/proc/self/maps").read_text().splitlines() if "/dev/shm" in line],
    }


async def run(test):
    net = Loopback(lease=0.5)
    try:
        try:
            async with mdm.Runtime(log=None) as runtime:
                await test(runtime, net)
        except ActorFailure as failure:
            return str(failure)
    finally:
        await net.close()
    return None


for _ in range(int(sys.argv[1])):
    failures = [asyncio.run(run(test)) for test in (decide, fail, used, leave, twice)]
    sys.stdout.write(json.dumps({"failures": failures, **left()}) + "\n")
