"""Agents in processes of their own, for tests over real sessions."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from contextlib import asynccontextmanager, suppress

from patience import PATIENCE
from places import ROOT

PROGRAM = ROOT / "tests" / "peer_program.py"


class Peer:
    """A process that runs `peer_program.py`."""

    def __init__(self, process):
        self.process = process
        self.heard = []

    def tell(self, **command):
        self.process.stdin.write(json.dumps(command).encode() + b"\n")

    async def hear(self, *wanted, where=lambda event: True):
        """Return the next event that has one of these names; those before it are skipped."""
        async with asyncio.timeout(PATIENCE):
            while True:
                line = await self.process.stdout.readline()
                if not line:
                    error = (await self.process.stderr.read()).decode()
                    raise AssertionError(f"the process ended; it said {self.heard} and {error}")
                event = json.loads(line)
                self.heard.append(event)
                if any(name in event for name in wanted) and where(event):
                    return event

    def signal(self, number):
        os.kill(self.process.pid, number)

    async def end(self):
        """Wait for the end of the process; return its exit status."""
        async with asyncio.timeout(PATIENCE):
            return await self.process.wait()


@asynccontextmanager
async def peers(program=PROGRAM, **environment):
    """Yield a function that starts a peer, in this environment; those that still run at the end are killed."""
    started = []

    async def start(**options):
        process = await asyncio.create_subprocess_exec(
            sys.executable, program, json.dumps({"team": "team", "lease": 2.0, **options}),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}", **environment},
        )  # fmt: skip
        peer = Peer(process)
        started.append(peer)
        return peer

    try:
        yield start
    finally:
        for peer in started:
            if peer.process.returncode is None:
                with suppress(ProcessLookupError):  # it has ended, and the loop has not heard of it
                    peer.signal(signal.SIGCONT)
                    peer.signal(signal.SIGKILL)
            await peer.process.communicate()
