"""Processes of this machine that run parts of a simulation: an executor that goes on where one of them is killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

from mdm.checks import is_whole
from mdm.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future


class Processes(Executor):
    """Processes of this machine, for the ``executor`` of a simulation.

    They start when there is work, and stay for the next; Ctrl-C is left to the process that made them, with which they
    end. One that is killed takes the standard library's whole pool with it: `renew` makes another.

    Args:
        workers: How many; by default as many as there are processors.

    Raises:
        ConfigError: If that is no whole number of 1 or more.

    Example::

        def value(model, policy):
            with mdm.simulation.Processes(4) as workers:
                return mdm.evaluate(model, policy, episodes=1_000_000, executor=workers).mean
    """

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and not (is_whole(workers) and workers >= 1):
            raise ConfigError(f"a number of processes is a whole number from 1 on, not {workers!r}", key="workers")
        here = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
        self.workers = workers or here or 1
        self._pool: ProcessPoolExecutor | None = None
        self._closed = False

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Have a function called in a process, which starts where none is idle."""
        if self._closed:
            raise RuntimeError("cannot schedule new futures after shutdown")
        if self._pool is None:
            context = multiprocessing.get_context("spawn")  # a fork would have the locks of this process' threads
            self._pool = ProcessPoolExecutor(self.workers, context, initializer=_begin)
        return self._pool.submit(function, *arguments, **named)

    def renew(self) -> None:
        """End the processes in the middle of their parts; others start with the next work."""
        if self._pool is not None:
            for process in list((getattr(self._pool, "_processes", None) or {}).values()):
                process.kill()
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, where `wait` is false at once."""
        self._closed = True
        if not wait:
            self.renew()
        elif self._pool is not None:
            self._pool.shutdown(cancel_futures=cancel_futures)


def _begin() -> None:
    """Load the simulation, leave Ctrl-C to the process that waits for them, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end, daemon=True).start()
    import mdm.simulation.batch  # noqa: F401, PLC0415 - in the process that begins alone


def _end() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
