"""A process that searches, as the program that started it sees it."""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from mdm.compilation import COMPILE_TIME
from mdm.runtime.process.frames import HEADER, frame, unframed

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.policies import Deliberating
    from mdm.policies.policy import Found

__all__ = ["SearchProcess"]

_PATIENCE = 0.5


class SearchProcess:
    """Runs a policy's search in a process of its own; it imports nothing of the program, only the library.

    Args:
        policy: The search policy.
    """

    def __init__(self, policy: Deliberating) -> None:
        self._policy = policy
        self._process: asyncio.subprocess.Process | None = None
        self._waiting: tuple[int, npt.NDArray[Any], npt.NDArray[Any]] | None = None
        self._sending: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int | None:
        """The process's number, once it has been started."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start it, and wait until it is ready.

        Raises:
            EOFError: If it ended before.
            OSError: If it could not be started.
        """
        # A session of its own: Ctrl-C is for the program, which then ends it.
        program = f"from {self._policy.worker} import main; main(tells={COMPILE_TIME.is_told})"
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-c", program),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,
        )
        self._input.transport.set_write_buffer_limits(high=0)
        self._input.write(await asyncio.to_thread(frame, self._policy.parts()))
        await self._receive()

    def ask(self, number: int, states: npt.NDArray[Any], weights: npt.NDArray[Any]) -> None:
        """Send a question, in place of one that is not answered yet; returns at once.

        Where the process does not read, the newest question alone waits.
        """
        self._waiting = (number, states, weights)
        if self._sending is not None and not self._sending.done():
            return
        if self._input.transport.get_write_buffer_size():
            self._sending = asyncio.get_running_loop().create_task(self._send_when_read())
        else:
            self._send()

    def _send(self) -> None:
        question, self._waiting = self._waiting, None
        self._input.write(frame(question))

    async def _send_when_read(self) -> None:
        with suppress(ConnectionError):  # of which the caller that waits for the answer learns
            await self._input.drain()
            self._send()

    async def answer(self) -> tuple[int, Found]:
        """Wait for the next answer: the question's number and the result.

        Raises:
            EOFError: If the process has ended.
        """
        number, result = await self._receive()
        return number, result

    async def end(self) -> int | None:
        """End it, and return its status; None where there was none."""
        process = self._process
        if process is None:
            return None
        if self._sending is not None:
            self._sending.cancel()
        if process.stdin is not None:
            process.stdin.close()  # which ends it by itself, even if nobody waits here any more
        try:
            return await asyncio.wait_for(process.wait(), _PATIENCE)
        except TimeoutError:
            process.kill()
            return await process.wait()

    @property
    def _input(self) -> asyncio.StreamWriter:
        assert self._process is not None
        assert self._process.stdin is not None
        return self._process.stdin

    async def _receive(self) -> Any:
        assert self._process is not None
        assert self._process.stdout is not None
        read = self._process.stdout.readexactly
        try:
            length = int.from_bytes(await read(HEADER), "big")
            return unframed(await read(length))
        except (asyncio.IncompleteReadError, ConnectionError) as error:
            raise EOFError from error
