"""Work: a task that an actor owns, whose end comes back to it as a turn."""

from __future__ import annotations

import asyncio
import inspect
import sys
from typing import TYPE_CHECKING, Any

from mdm.runtime.executors import OWNER, Jobs
from mdm.runtime.supervision import LEAVING

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable

__all__ = ["Work", "wait_all"]

_ROOM = 100


class Work:
    """A running coroutine of one actor.

    It has ended when its task has, and all that it handed to executors. Work is cancelled once, as asyncio does it, and
    not again at each later ``await`` as an anyio task group would: what it awaits while it cleans up is left in peace
    until its owner's patience ends.

    Args:
        awaitable: What to run.
        name: The task's name, for debuggers.
        ended: Called once, when it has ended, from the event loop.
        jobs: What was handed to executors already, where it was made.
    """

    __slots__ = (
        "_awaitable",
        "_begun",
        "_ended",
        "_jobs",
        "_leaving",
        "abandoned",
        "interrupted",
        "name",
        "over",
        "task",
    )

    def __init__(
        self, awaitable: Awaitable[Any], name: str, ended: Callable[[Work], object], jobs: Jobs | None = None
    ) -> None:
        self.name = name
        self.abandoned = False
        # Whether a cancellation has reached it: what it returns after that is not the end that was asked for.
        self.interrupted = False
        self._ended = ended
        self._awaitable = awaitable
        self._leaving: BaseException | None = None
        self._jobs = Jobs() if jobs is None else jobs
        self._jobs.ended = self._settle
        self._begun = False
        self.over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.task: asyncio.Task[Any] = asyncio.get_running_loop().create_task(self._run(), name=name)
        self.task.add_done_callback(self._done)
        hide(self.task)

    async def _run(self) -> Any:
        OWNER.set(self._jobs)
        self._begun = True
        try:
            return await self._awaitable
        except LEAVING as error:
            self._leaving = error  # from a task it would end the event loop at once, and the actors with it
            return None

    def _done(self, task: asyncio.Task[Any]) -> None:
        if inspect.iscoroutine(self._awaitable):
            self._awaitable.close()  # which has not begun, where it was cancelled at once
        if not task.cancelled():
            task.exception()  # looked at here, so that asyncio does not report it a second time
        self._settle()

    def abandon(self) -> None:
        """Let it go on without its owner; what else ends the program's tasks may end it, too."""
        self.abandoned = True
        if not self.task.done():
            asyncio._register_task(self.task)  # noqa: SLF001 - as in `hide`

    def _settle(self) -> None:
        if self.done and not self.over.done():
            self.over.set_result(None)
            self._ended(self)

    @property
    def begun(self) -> bool:
        """Whether its first step has been taken."""
        return self._begun

    @property
    def is_calling(self) -> bool:
        """Whether the caller runs within this work's own task."""
        return asyncio.current_task() is self.task

    def cancel(self) -> None:
        """Ask it to end; where its own code brought this about, after its present step, which may be its last."""
        if self.is_calling:
            asyncio.get_running_loop().call_soon(self._interrupt)
        else:
            self._interrupt()

    def _interrupt(self) -> None:
        limit = sys.getrecursionlimit()
        try:
            self._interrupt_within(limit + _ROOM)
        finally:
            sys.setrecursionlimit(limit)  # not by the function that is called: the last one there is room for could not

    def _interrupt_within(self, limit: int) -> None:
        sys.setrecursionlimit(limit)  # a task whose cancellation a deep stack cuts short would never end
        if asyncio.isfuture(self._awaitable) and not self._begun:
            self.interrupted = self._awaitable.cancel()  # it goes on without us: its end is awaited all the same
        elif self.task.cancel():
            self.interrupted = True

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self.task.done() and not self._jobs.count

    @property
    def cancelled(self) -> bool:
        """Whether it ended because it was cancelled."""
        return self.task.cancelled()

    @property
    def error(self) -> BaseException | None:
        """What it raised, if it has ended and did."""
        if self._leaving is not None:
            return self._leaving
        if not self.task.done() or self.task.cancelled():
            return None
        return self.task.exception()

    @property
    def result(self) -> Any:
        """What it returned, if it has ended and did."""
        return self.task.result() if self.task.done() and not self.task.cancelled() and not self.error else None


async def wait_all(work: Iterable[Work], seconds: float) -> None:
    """Wait until all of it has ended, or so many seconds have passed."""
    await asyncio.wait([piece.over for piece in work], timeout=seconds)


def hide(task: asyncio.Task[Any] | None) -> None:
    """Take a task out of `asyncio.all_tasks`.

    asyncio's runner cancels all that it finds there when a program ends, at once and in no order. Actors' tasks are
    ended by whoever owns them.
    """
    if task is not None:
        asyncio._unregister_task(task)  # noqa: SLF001 - meant for event loops' authors
