"""The crew: a process for each agent of a team on this machine, started, watched, started again and ended in order."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from mdm.runtime import Restart
from mdm.runtime.process.rendering import Rendering
from mdm.runtime.process.writer import Stream, Writer
from mdm.runtime.supervision import RestartBudget

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_FIRST_WAIT = 0.5
_LONGEST_WAIT = 10.0
_RESTARTS, _WITHIN = 5, 60.0
_LAST_WORDS = 1.0
_SILENCE, _AGAIN = 2.0, 10.0
"""Seconds after which it is said who has not ended, for the first time and then again."""

_LONGEST_LINE = 1 << 16

_ASKED = {128 + number: number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
"""The exit statuses of an agent that has ended in order because it was asked to by a signal."""


class Crew:
    """The processes of a team's agents.

    One that fails, or is killed, is started again, after 0.5 s at first and twice as long each time, five times within
    a minute at most. One that fails before it was up for the first time is not: it would fail again; and neither is one
    that has ended in order because a signal, such as SIGTERM, asked it to. The others go on without it. They are ended
    in order by the end of their standard input; those that have not ended in time are killed.

    Args:
        commands: The command of each agent's process; it logs JSON lines on standard error.
        console: Where their lines are printed.
        patience: Seconds that they have to end in order: the limits of their safe actions are among them.

    Attributes:
        failures: How often each agent's process failed.
    """

    def __init__(self, commands: Mapping[str, Sequence[str]], console: Console, patience: float) -> None:
        self.failures = dict.fromkeys(commands, 0)
        self._commands = commands
        self._console = console
        self._patience = patience
        self._processes: dict[str, asyncio.subprocess.Process] = {}
        self._ending = asyncio.Event()
        self._up: set[str] = set()

    async def run(self, seconds: float | None = None) -> None:
        """Run all agents until they have ended, `end` is called, or so many seconds have passed."""
        lives = [asyncio.create_task(self._live(agent)) for agent in self._commands]
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds):
                    await self._ended(lives)
            self.end()
            # Wait as long as they may take, and print the agents that are waited for.
            clock, late = asyncio.get_running_loop(), set(lives)
            until, told = clock.time() + self._patience, clock.time() + _SILENCE
            while late and (left := until - clock.time()) > 0:
                _, late = await asyncio.wait(late, timeout=max(min(left, told - clock.time()), 0))
                if late and told <= clock.time() < until:
                    told += _AGAIN
                    self._tell_late(until - clock.time())
            self.kill()
            await asyncio.gather(*lives)
        finally:
            self.kill()

    def _tell_late(self, left: float) -> None:
        for agent, process in self._processes.items():
            if process.returncode is None:
                way = ""
                if _is_stopped(process.pid):
                    way = f": its process is stopped, and goes on with `kill -CONT {process.pid}`"
                self._console.tell(agent, "ending", f"has not ended yet, and is killed in {left:.0f} s{way}")

    async def _ended(self, lives: Sequence[asyncio.Task[None]]) -> None:
        """Wait until all have ended, or are to end."""
        ending = asyncio.create_task(self._ending.wait())
        left: set[asyncio.Task[Any]] = {ending, *lives}
        try:
            while ending in left and len(left) > 1:
                _, left = await asyncio.wait(left, return_when=asyncio.FIRST_COMPLETED)
        finally:
            ending.cancel()

    def end(self) -> None:
        """End all agents in order."""
        self._ending.set()
        for process in self._processes.values():
            if process.stdin is not None:
                process.stdin.close()

    def kill(self) -> None:
        """End all agents that are still there at once."""
        for agent, process in self._processes.items():
            if process.returncode is None:
                self._console.tell(agent, "killed", "has not ended in order, and is killed")
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)

    # -- One agent -----------------------------------------------------------------------------------------------

    async def _live(self, agent: str) -> None:
        """Run an agent's process, again and again while there is sense in it."""
        budget = RestartBudget(Restart(limit=_RESTARTS, within=_WITHIN, backoff=_FIRST_WAIT, max_backoff=_LONGEST_WAIT))
        while not self._ending.is_set():
            status = await self._run(agent)
            if status == 0:
                if not self._ending.is_set():
                    self._console.tell(agent, "ended", "has ended")
                return
            if status in _ASKED and agent in self._up:
                by = f"has ended, asked by {_ASKED[status].name}"
                self._console.tell(agent, "ended", f"{by}, and is not started again")
                return
            self.failures[agent] += 1
            wait = budget.delay(time.monotonic_ns())
            text = _how(status)
            if self._ending.is_set():
                text += " when it was to end"
            elif agent not in self._up:
                text += " before it was up, and is not started again"
            elif wait is None:
                text += f", and is not started again: it was {_RESTARTS} times within {_WITHIN:g} s"
            else:
                self._console.tell(agent, "failed", f"{text}, and is started again in {wait:g} s", status=status)
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._ending.wait(), wait)
                continue
            self._console.tell(agent, "failed", text, status=status)
            return

    async def _run(self, agent: str) -> int:
        """Run an agent's process once; return its status."""
        process = self._processes[agent] = await asyncio.create_subprocess_exec(
            *self._commands[agent],
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        if self._ending.is_set():
            self.end()
        readers = [
            asyncio.create_task(self._read(agent, process.stdout, "output")),
            asyncio.create_task(self._read(agent, process.stderr, "log")),
        ]
        status = await process.wait()
        _, late = await asyncio.wait(readers, timeout=_LAST_WORDS)
        for reader in late:  # a process of its own has the pipe still
            reader.cancel()
        return status

    async def _read(self, agent: str, stream: asyncio.StreamReader | None, kind: Literal["output", "log"]) -> None:
        assert stream is not None
        rest = b""
        while data := await stream.read(_LONGEST_LINE):
            *lines, rest = (rest + data).split(b"\n")
            if len(rest) > _LONGEST_LINE:
                lines, rest = [*lines, rest], b""
            for line in lines:
                self._take(agent, kind, line)
        if rest:
            self._take(agent, kind, rest)

    def _take(self, agent: str, kind: Literal["output", "log"], line: bytes) -> None:
        record = _record(line) if kind == "log" else None
        if record is None:
            self._console.line(agent, kind, line.decode(errors="replace"))
            return
        if record.get("event") == "running" and record.get("actor") == agent:
            self._up.add(agent)
        self._console.record(agent, record)


def _record(line: bytes) -> dict[str, object] | None:
    """Return a line of a log as the record that it is, if it is one."""
    try:
        found = msgspec.json.decode(line)
    except (msgspec.MsgspecError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _is_stopped(process: int) -> bool:
    """Return whether a process is stopped by a signal; where the system does not say so, it is not."""
    try:
        return Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()[0] in {b"T", b"t"}
    except (OSError, IndexError):
        return False


def _how(status: int) -> str:
    """Return how a process has ended, in words."""
    if status > 0:
        return f"has failed with status {status}"
    try:
        name = signal.Signals(-status).name
    except ValueError:
        name = f"signal {-status}"
    return f"was ended by {name}"


_COLOURS = (36, 33, 32, 35, 34, 31)
_RESET = "\x1b[0m"


class Console:
    """Prints lines of agents, on a thread: a console that nobody reads delays no agent.

    Args:
        agents: The agents, each of which has a colour where a terminal is written to.
        json: Print JSON lines: the agents' logs on standard error, their other output on standard output.
    """

    def __init__(self, agents: Sequence[str], *, json: bool) -> None:
        self._json = json
        self._writer = Writer()
        self._width = max(map(len, agents))
        self._colours = {agent: _COLOURS[place % len(_COLOURS)] for place, agent in enumerate(agents)}
        self._streams = {
            "output": Stream(sys.stdout, lambda: self._writer.given_up),
            "log": Stream(sys.stderr, lambda: self._writer.given_up),
        }
        self._render = Rendering(colours=self._streams["log"].colours)

    def open(self) -> None:
        """Begin to print."""
        self._writer.open()

    def close(self) -> int:
        """Print the waiting lines; return how many lines were lost because nobody read them."""
        self._writer.close()
        return self._writer.statistics().lost

    def line(self, agent: str, stream: Literal["output", "log"], text: str) -> None:
        """Print the lines of an agent."""
        if self._json:
            self._put(stream, msgspec.json.encode({"agent": agent, "event": stream, "text": text}).decode())
        else:
            self._put(stream, f"{self._name(agent, self._streams[stream])} {text}")

    def record(self, agent: str, record: dict[str, object]) -> None:
        """Print a record of an agent's log."""
        if self._json:
            self._put("log", msgspec.json.encode({"agent": agent, **record}).decode())
        else:
            self.line(agent, "log", self._render(None, "", record))

    def tell(self, agent: str, event: str, text: str, **facts: object) -> None:
        """Print a change of an agent's process."""
        if self._json:
            self.record(agent, {"event": event, "text": text, **facts})
        else:
            self.line(agent, "log", f"* {text}")

    def _put(self, stream: Literal["output", "log"], text: str) -> None:
        self._writer.put(self._streams[stream].write, text)

    def _name(self, agent: str, stream: Stream) -> str:
        name = f"{agent:{self._width}} |"
        return f"\x1b[{self._colours[agent]}m{name}{_RESET}" if stream.colours else name
