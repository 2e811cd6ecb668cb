"""Two robots that reach each other by mapped ports, or by a router, in network namespaces of this machine.

Run by `unshare -Urnm python mapped_program.py FOLDER` it is root, and what it makes goes with it. Each robot's
namespace has a way to this one, which forwards nothing, as the host of two containers. The folder has the team's
file, and `router.py`, if one is to run.

It prints one line of JSON: the exit status of `mdm team status` when it was 0 and all decided at last, and its answer.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from patience import PATIENCE

HOST = "10.79.9.1"
ROBOTS = {"a": 1, "b": 2}
MAPPED = {"a": 17447, "b": 17448}


def prepare():
    """Make the namespaces of the robots, each with a way to this one."""
    commands = ["mount -t tmpfs none /run", "ip link set lo up", f"ip addr add {HOST}/32 dev lo"]
    for agent, number in ROBOTS.items():
        net = f"10.79.{number}"
        commands += [
            f"ip netns add {agent}",
            f"ip link add host{number} type veth peer name robot netns {agent}",
            f"ip addr add {net}.1/24 dev host{number}",
            f"ip link set host{number} up",
            f"ip -n {agent} addr add {net}.2/24 dev robot",
            f"ip -n {agent} link set robot up",
            f"ip -n {agent} link set lo up",
            f"ip -n {agent} route add default via {net}.1",
        ]
    for command in commands:
        subprocess.run(command.split(), check=True, timeout=PATIENCE)


async def copy(reader, writer):
    with suppress(OSError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    writer.close()


async def map_port(agent):
    """Bring what comes to the robot's port of the host to the port at which it listens, as `docker run -p` does."""

    async def bring(reader, writer):
        try:
            there, back = await asyncio.open_connection(f"10.79.{ROBOTS[agent]}.2", 7447)
        except OSError:
            writer.close()
            return
        await asyncio.gather(copy(reader, back), copy(there, writer))

    return await asyncio.start_server(bring, HOST, MAPPED[agent])


async def python(*words, within=None):
    before = [] if within is None else ["ip", "netns", "exec", within]
    quiet = asyncio.subprocess.DEVNULL
    return await asyncio.create_subprocess_exec(*before, sys.executable, *map(str, words), stdout=quiet, stderr=quiet)


async def status(file):
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "mdm", "team", "status", file, "--json"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    output, errors = await process.communicate()
    return process.returncode, json.loads(output or "{}"), errors.decode()


def decides(told):
    """Whether the status is 0, and all have joined by now: who still joins is stopped."""
    code, answers, _ = told
    return code == 0 and all(one["joint"]["mode"] == "deciding" for one in answers["agents"].values())


async def main(folder):
    file, router = folder / "team.toml", folder / "router.py"
    servers = [] if router.exists() else [await map_port(agent) for agent in ROBOTS]
    running = [await python("-m", "mdm", "team", "run", file, "--agent", agent, within=agent) for agent in ROBOTS]
    if router.exists():
        protocol = "tls" if (folder / "keys").exists() else "tcp"
        running.append(await python(router, file, f"{protocol}/0.0.0.0:7447"))
    try:
        async with asyncio.timeout(PATIENCE):
            while not decides(told := await status(file)):
                pass
    except TimeoutError:
        told = await status(file)
    finally:
        for process in running:
            process.kill()
            await process.wait()
        for server in servers:
            server.close()
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    prepare()
    asyncio.run(main(Path(sys.argv[1])))
