"""Executors: work knows the jobs that it hands to threads and processes, and they outlive it by its grace at most.

A thread goes on when the task that awaits it is cancelled. An event loop whose `run_in_executor` is watched, which
`asyncio.to_thread` calls too, tells the work that called it when its jobs have really ended.
"""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable
    from concurrent.futures import Executor, Future

__all__ = ["OWNER", "Jobs", "unwatch", "watch"]


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
