"""Work: a task that an actor owns, whose end comes back to it as a turn; and all that an actor has at work.

A thread goes on when the task that awaits it is cancelled. An event loop whose `run_in_executor` is watched, which
`asyncio.to_thread` calls too, notifies the work that called it when its jobs have really ended: they outlive it by its
grace at most.
"""

from __future__ import annotations

import asyncio
import inspect
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

from mdm.errors import Error
from mdm.runtime.channel import Subscription
from mdm.runtime.handler import check_plain
from mdm.runtime.supervision import LEAVING, ActorFailure, text_of

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable
    from concurrent.futures import Executor, Future

    from mdm.runtime.actor import Actor


class Jobs:
    """The jobs that one piece of work has handed to executors and that have not ended.

    Attributes:
        count: How many.
        ended: Called on the event loop when one of them has ended.
    """

    def __init__(self, owner: object = None) -> None:
        self.count = 0
        self.ended: Callable[[], object] | None = None
        self._owner = owner

    @classmethod
    def of(cls, owner: object) -> Jobs:
        """Return the jobs of an owner: itself, or those made for an object such as an action when it needs some.

        An object is known by its identity, and lives as long as its jobs.
        """
        if isinstance(owner, Jobs):
            return owner
        jobs = _OWNED.get(id(owner))
        if jobs is None:
            jobs = _OWNED[id(owner)] = Jobs(owner)
        return jobs

    def call(self, function: Callable[..., Any], *args: object) -> Any:
        """Call a function; jobs count that it, and the tasks that it makes, hand to executors."""
        token = OWNER.set(self)
        try:
            return function(*args)
        finally:
            OWNER.reset(token)

    def begin(self) -> None:
        """Count one more."""
        self.count += 1

    def end(self) -> None:
        """Count one less."""
        self.count -= 1
        if self.ended is not None:
            self.ended()


_OWNED: WeakValueDictionary[int, Jobs] = WeakValueDictionary()

OWNER: ContextVar[object] = ContextVar("mdm_jobs", default=None)
"""The owner of the jobs of the work whose code runs, its own tasks included: see `Jobs.of`."""


def watch(loop: asyncio.AbstractEventLoop) -> None:
    """Watch the jobs that a loop hands to executors; each call is undone by one of `unwatch`."""
    watched = vars(loop).get("run_in_executor")
    if not isinstance(watched, _Watched):
        watched = _Watched(loop)
        loop.run_in_executor = watched  # type: ignore[method-assign,assignment]
    watched.users += 1


def unwatch(loop: asyncio.AbstractEventLoop) -> None:
    """Give the loop its own way back, where nobody else watches it."""
    watched = vars(loop).get("run_in_executor")
    if isinstance(watched, _Watched):
        watched.users -= 1
        if not watched.users:
            del loop.run_in_executor


class _Watched:
    """A loop's `run_in_executor`."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.users = 0
        self._loop = loop
        self._original = loop.run_in_executor

    def __call__(self, executor: Executor | None, function: Callable[..., Any], *args: Any) -> Any:
        owner = OWNER.get()
        if owner is None:
            return self._original(executor, function, *args)
        job = _Job(self._loop, Jobs.of(owner))
        try:
            if executor is not None and not isinstance(executor, ThreadPoolExecutor):
                return self._original(_Submitting(executor, job), function, *args)  # type: ignore[arg-type]
            future: asyncio.Future[Any] = self._original(executor, job.run, function, *args)
        except BaseException:
            job.drop()
            raise
        future.add_done_callback(job.drop)
        return future


class _Job:
    """A job that one piece of work has handed to an executor."""

    def __init__(self, loop: asyncio.AbstractEventLoop, jobs: Jobs) -> None:
        self._loop = loop
        self._jobs = jobs
        self._lock = threading.Lock()
        self._state = "waiting"
        jobs.begin()

    def run(self, function: Callable[..., Any], *args: Any) -> Any:
        """Run a function in the executor's thread, unless nobody waited for it before it began."""
        with self._lock:
            if self._state == "dropped":
                return None
            self._state = "running"
        try:
            return function(*args)
        finally:
            self.ended()

    def drop(self, _: object = None) -> None:
        """Count it no more where it has not begun: its future is cancelled, or it was not to be had.

        An executor that has no thread to begin it in may have queued it all the same. It then never begins.
        """
        with self._lock:
            if self._state != "waiting":
                return
            self._state = "dropped"
        self._jobs.end()

    def ended(self, _: object = None) -> None:
        """Notify the work, from any thread."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._jobs.end)


class _Submitting:
    """Another executor, whose jobs may run in other processes: their futures tell when they end."""

    def __init__(self, executor: Executor, job: _Job) -> None:
        self._executor = executor
        self._job = job

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        future = self._executor.submit(function, *args)
        future.add_done_callback(self._job.ended)
        return future


_ROOM = 100


class Work:
    """A running coroutine of one actor.

    It has ended when its task has, and all that it handed to executors. Work is cancelled once, as asyncio does it, and
    not again at each later ``await`` as an anyio task group would: its awaits while it cleans up are left in peace
    until its owner's patience ends.

    Args:
        awaitable: The coroutine or future to run.
        name: The task's name, for debuggers.
        ended: Called once, when it has ended, from the event loop.
        jobs: The jobs that were handed to executors where it was made.
    """

    __slots__ = (
        "_begun",
        "_ended",
        "_jobs",
        "_leaving",
        "abandoned",
        "awaitable",
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
        self.awaitable = awaitable
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
            return await self.awaitable
        except LEAVING as error:
            self._leaving = error  # from a task it would end the event loop at once, and the actors with it
            return None

    def _done(self, task: asyncio.Task[Any]) -> None:
        if inspect.iscoroutine(self.awaitable):
            self.awaitable.close()  # which has not begun, where it was cancelled at once
        if not task.cancelled():
            task.exception()  # looked at here, so that asyncio does not report it a second time
        self._settle()

    def abandon(self) -> None:
        """Let it go on without its owner; the end of the program's tasks may still end it."""
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
        if asyncio.isfuture(self.awaitable) and not self._begun:
            self.interrupted = self.awaitable.cancel()  # it goes on without us: its end is awaited all the same
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
        """Its error, if it has ended with one."""
        if self._leaving is not None:
            return self._leaving
        if not self.task.done() or self.task.cancelled():
            return None
        return self.task.exception()

    @property
    def failure(self) -> str | None:
        """The type and text of its error, if it has ended with one."""
        error = self.error
        return None if error is None else f"{type(error).__name__}: {text_of(error)}"

    @property
    def result(self) -> Any:
        """Its result, if it has ended with one."""
        return self.task.result() if self.task.done() and not self.task.cancelled() and not self.error else None


async def wait_all(work: Iterable[Work], seconds: float) -> None:
    """Wait until all of it has ended, or so many seconds have passed."""
    await asyncio.wait([piece.over for piece in work], timeout=seconds)


def hide(task: asyncio.Task[Any] | None) -> None:
    """Take a task out of `asyncio.all_tasks`.

    asyncio's runner cancels all that it finds there when a program ends, at once and in no order. Actors' tasks are
    ended by their owners.
    """
    if task is not None:
        asyncio._unregister_task(task)  # noqa: SLF001 - meant for event loops' authors


class Workload:
    """The work of one actor, whose ends are turns of it.

    Args:
        actor: Whose.

    Attributes:
        open: Whether more may begin.
    """

    __slots__ = ("_actor", "_work", "open")

    def __init__(self, actor: Actor) -> None:
        self._actor = actor
        self._work: dict[Work, None] = {}
        self.open = False

    def __len__(self) -> int:
        return len(self._work)

    def begin(
        self, awaitable: Awaitable[Any], ended: Callable[[Work], object] | None, name: str, jobs: Jobs | None
    ) -> Work:
        """Run a coroutine as a task; see `Actor.spawn`."""
        actor = self._actor
        try:
            if not self.open:
                raise Error(f"actor {actor.path!r} does not run, so it cannot begin work {name!r}")
            if not inspect.isawaitable(awaitable):
                raise Error(f"work is an awaitable, such as what an async function returns, not {awaitable!r}")
            if ended is not None:
                check_plain(ended, f"what is called at the end of work {name!r}")
        except Error:
            if inspect.iscoroutine(awaitable):
                awaitable.close()
            raise
        turn = Subscription(None, actor, ended if ended is not None else _judge)
        runtime = actor.runtime
        dispatcher = runtime.dispatcher

        def done(work: Work) -> None:
            self._work.pop(work, None)
            if not work.abandoned:
                dispatcher.deliver(turn, work)
            else:  # a list of its own: whoever goes through the old one, awaiting each, misses none
                runtime.abandoned = [other for other in runtime.abandoned if other is not work]
            if isinstance(work.error, LEAVING):
                runtime.abort(work.error)

        work = Work(awaitable, f"mdm:{actor.path}/{name or 'work'}", done, jobs)
        self._work[work] = None
        return work

    def abandon(self, work: Work) -> None:
        """Own a piece of it no longer."""
        work.abandon()
        self._work.pop(work, None)
        if not work.done:
            self._actor.runtime.abandoned.append(work)

    async def end(self, grace: float) -> None:
        """Cancel all of it, wait for so many seconds, and abandon the rest; when cancelled, at once."""
        clock = self._actor.runtime.clock
        began = clock.now()
        asked: set[Work] = set()
        try:
            while self._work:
                for work in self._work:  # the end of one may have begun another
                    if work not in asked:
                        asked.add(work)
                        work.cancel()
                remaining = grace - (clock.now() - began) / 1e9
                if remaining <= 0:
                    break
                await wait_all(self._work, remaining)
        finally:
            waited = (clock.now() - began) / 1e9
            for work in tuple(self._work):
                self.abandon(work)
                self._actor.report("abandoned", f"{work.name} did not end within {waited:.3g} s of being cancelled")


def _judge(work: Work) -> None:
    if work.error is not None:
        raise work.error
    if work.cancelled and not work.interrupted:
        raise ActorFailure(f"work {work.name!r} was cancelled, but not by its actor")
