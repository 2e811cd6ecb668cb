"""The tasks of a tree's leaves: what one leaf has begun ends before another begins."""

import asyncio
from collections.abc import Awaitable, Callable


class Tasks:
    """What the leaves of a tree have begun.

    A tree halts one leaf and starts another within a tick, while the work of the first may take its time to end, as a
    robot that brakes. So work begins when all that was cancelled has ended.
    """

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[object]] = set()
        self._errors: list[BaseException] = []
        self._change = asyncio.Event()

    def begin(self, work: Callable[[], Awaitable[object]]) -> asyncio.Task[object]:
        """Run an async function as a task."""
        task = asyncio.create_task(self._run(work))
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    async def _run(self, work: Callable[[], Awaitable[object]]) -> object:
        while ending := [task for task in self._tasks if task.cancelling()]:
            await asyncio.wait(ending)
        return await work()

    def _ended(self, task: asyncio.Task[object]) -> None:
        self._change.set()
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._errors.append(error)

    def taken(self) -> None:
        """Have one more tick: a leaf has taken the end of its work in this one, and what is above it may go on then."""
        self._change.set()

    async def change(self, period: float | None) -> None:
        """Wait until work has ended, so that a tick makes sense, or so many seconds have passed.

        Raises:
            ValueError: If the period is not above 0: nothing else would have its turn.
            RuntimeError: If there is nothing to wait for.
        """
        if period is not None and not period > 0:
            raise ValueError(f"a tree's period is a number of seconds above 0, not {period}")
        if period is None and not self._tasks and not self._change.is_set():
            raise RuntimeError("the tree runs, but none of its leaves waits for work: give it a period")
        try:
            async with asyncio.timeout(period):
                await self._change.wait()
        except TimeoutError:
            pass
        self._change.clear()

    async def end(self) -> None:
        """Cancel all work, wait until it has ended, and raise what was raised first."""
        for task in self._tasks:
            cancel(task)
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for error in self._errors:
            raise error


def cancel(task: asyncio.Task[object]) -> None:
    """Cancel a task once: a second time would cut off what it does to come to its end."""
    if not task.cancelling():
        task.cancel()
