"""Long work in parts, on any `concurrent.futures.Executor`: on processes here, on other machines, in any order.

A work is a number of units, such as episodes. A part is some consecutive units, as plain data, joined until they take a
second; `run_part` runs one anywhere. Results are joined in the order of units: they depend on the work and its seed
alone, not on how many workers there are, which parts ended first or ran twice. A model and the work with it travel
once to each worker: a part has their digests, a worker that lacks one says so, and is sent it with the part.
"""

from __future__ import annotations

import io
import math
import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
import time
import traceback
import warnings
from collections import Counter, deque
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor, wait
from functools import cache
from pkgutil import resolve_name
from types import FunctionType
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from mdm.checks import is_whole
from mdm.errors import ConfigError, Error
from mdm.models.digest import of_bytes
from mdm.texts import counted
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from concurrent.futures import Future

    _Units = tuple[int, int]

_LONG = 1.0
"""Seconds that a part of joined units takes."""
_UNKNOWN = 64
"""Parts at a time, for executors that do not say how many workers they have."""
_KILLED = 3
"""How often a part that runs alone may lose its worker and is run again."""
_HOPELESS = 10
"""Units that fail, before any part has ended, after which there are no more."""
_Result = tuple[list[Any], int, tuple["Worker", ...]]


class WorkerWarning(UserWarning):
    """Something of parts that run on workers: some are missing, hosts differ, or each worker searches by itself."""


class Work(Protocol):
    """Work that has parts: units in a model, which travels by itself, each with random numbers of its own.

    Attributes:
        seed: That of all units; unit n has the random numbers of the spawn key (n,).
    """

    model: Any
    policy: Any
    seed: int
    units: int

    def size(self, first: int, last: int) -> int:
        """Return how many episodes are in these units."""
        ...

    def prepare(self) -> None:
        """Make all that its units share, once in each worker."""
        ...

    def run(self, first: int, last: int, tell: Callable[[int], bool] = lambda _: False) -> Any:
        """Run these units; told how many episodes have ended, `tell` returns True to have the result of those alone."""
        ...


class Part(msgspec.Struct, frozen=True):
    """Some units of a work, as plain data.

    Attributes:
        first: The spawn key of the first unit.
        last: That after the last unit.
        seed: Of the work.
        needs: The digests of the model, and of all else.
        number: How many were sent before, so that no two are the same.
        version: That of mdm where it was made.
    """

    first: int
    last: int
    seed: int
    needs: tuple[str, str]
    number: int = 0
    version: str = __version__


class Worker(msgspec.Struct, frozen=True):
    """A process that has run parts.

    Attributes:
        host: The name of its machine.
        process: Its number there.
        environment: The versions of the libraries there.
        parts: How many it ran.
        seconds: How long they took.
    """

    host: str
    process: int
    environment: dict[str, str]
    parts: int = 0
    seconds: float = 0.0


class Answer(msgspec.Struct, frozen=True):
    """The end of a part: its result, all that its worker lacks, or why it failed.

    Attributes:
        worker: Who ran it, and for how long.
        result: The result of its units.
        lacks: The digests of all that the worker has to be sent.
        failure: Why it failed, with the traceback of an error that is not of mdm.
    """

    worker: Worker
    result: Any = None
    lacks: tuple[str, ...] = ()
    failure: str = ""


# -- At the worker -----------------------------------------------------------------------------------------------------

_held = threading.local()
"""The last model and work of each thread: works hold things of their own, such as random numbers."""


def run_part(part: Part, sent: Mapping[str, bytes]) -> Answer:
    """Run a part here, with the content sent with it or before; its seconds are those of its units alone."""
    here, held = _here(), _held.__dict__
    if part.version != __version__:
        wrong = f"{here.host} has mdm {__version__}, and the part is of {part.version}: install the same"
        return Answer(here, failure=wrong)
    model, rest = part.needs
    try:
        if held.get("needs") != part.needs:
            lacks = (rest,) if held.get("digest") == model else part.needs
            if not sent.keys() >= set(lacks):
                return Answer(here, lacks=lacks)
            held.pop("needs", None)
            if held.get("digest") != model:
                held.clear()
                held.update(model=pickle.loads(sent[model]), digest=model)  # noqa: S301 - its program's own
            held["work"] = _Reader(io.BytesIO(sent[rest])).load()
            held["work"].prepare()
            held["needs"] = part.needs
        began = time.perf_counter()
        result = held["work"].run(part.first, part.last)
        seconds = time.perf_counter() - began
    except Error as error:
        return Answer(here, failure=str(error))
    except Exception as error:
        return Answer(here, failure=f"{type(error).__name__}: {error}\n{traceback.format_exc().rstrip()}")
    return Answer(msgspec.structs.replace(here, parts=1, seconds=seconds), result)


@cache
def _here() -> Worker:
    from mdm.recording.recorder import environment  # noqa: PLC0415 - loaded where parts are run

    return Worker(socket.gethostname(), os.getpid(), environment())


class _Reader(pickle.Unpickler):
    def persistent_load(self, _: Any) -> Any:
        return _held.model


class _Writer(pickle.Pickler):
    """Pickles without the model, which travels by itself, and refuses names that a worker could not import."""

    apart: Any = _held  # which nothing holds

    def persistent_id(self, given: Any) -> str | None:
        return "model" if given is self.apart else None

    def reducer_override(self, given: Any) -> Any:
        if isinstance(given, type | FunctionType) and given.__module__ == "__main__":
            raise ConfigError(f"{given.__qualname__} is in the program itself: put it into a module that it imports")
        return NotImplemented


def _packed(given: Any, name: str, apart: Any = _held) -> bytes:
    buffer = io.BytesIO()
    writer = _Writer(buffer, protocol=5)
    writer.apart = apart
    try:
        writer.dump(given)
    except Exception as error:
        raise ConfigError(f"{name} cannot be sent to workers: {error}", key="executor") from error
    return buffer.getvalue()


# -- At the one who waits ----------------------------------------------------------------------------------------------


def run_parts(
    work: Work, executor: Executor | None = None, progress: Callable[[int, int], object] | None = None
) -> _Result:
    """Run a work to its end.

    Args:
        work: The work.
        executor: Who runs its parts; None for this process, at once.
        progress: Called with how many episodes have ended, and of how many, ten times a second with an executor; where
            it returns True, the results are those known by then.

    Returns:
        The results of parts in the order of units, how many episodes have none, since their part failed, and who ran
        the parts.

    Raises:
        ConfigError: If the executor is none, takes no work, cannot be sent this work, or has a worker with no mdm or
            with another version.
        Error: If a part failed twice, or the executor ended, and no part had ended before.

    Warns:
        WorkerWarning: If parts are missing, hosts differ in versions that change last bits, or each worker searches.
    """
    total = work.size(0, work.units)

    def tell(ended: int) -> bool:
        return progress is not None and progress(ended, total) is True

    if executor is None:
        work.prepare()
        return [work.run(0, work.units, tell)], 0, ()
    if not isinstance(executor, Executor):
        raise ConfigError(f"an executor is one of concurrent.futures, not {executor!r}", key="executor")
    run = _Run(work, executor)
    try:
        while run.submit():
            run.wait()
            if tell(run.done):
                break
    finally:
        for future in run.open:
            future.cancel()
        if run.open and isinstance(executor, Processes):
            executor.renew()
    return run.joined()


class _Run:
    """A work under way on an executor."""

    def __init__(self, work: Work, executor: Executor) -> None:
        self._work, self._executor = work, executor
        self._dask = getattr(executor, "_client", None)
        count = getattr(executor, "workers", None) or getattr(executor, "_max_workers", None)
        self._count: int = count or (0 if self._dask is None else sum(self._dask.nthreads().values()))
        self._check()
        content = _packed(work.model, "the model"), _packed(work, "the policy", work.model)
        self._needs = of_bytes(content[0]), of_bytes(content[1])
        self._content = dict(zip(self._needs, content, strict=True))
        self._next = self._number = self.done = 0
        self._joined, self._stopped = 1, ""
        self.open: dict[Future[Answer], _Units] = {}
        self._again: deque[tuple[_Units, tuple[str, ...]]] = deque()
        self._tries: Counter[_Units] = Counter()
        self._suspects: set[_Units] = set()
        """The parts that ran when a worker was killed: they run alone, so that one that kills its worker is known."""
        self._results: dict[_Units, Any] = {}
        self._failed: dict[_Units, str] = {}
        self._workers: dict[tuple[str, int], Worker] = {}

    def _check(self) -> None:
        """Refuse workers before the first part."""
        name = "mdm.version:__version__"
        try:
            if self._dask is not None:
                found = self._dask.run(resolve_name, name)
            else:
                found = {"a worker": self._executor.submit(resolve_name, name).result()}
        except ImportError as error:
            wrong = f"a worker has no mdm ({error}): install mdm {__version__} there"
        except BrokenExecutor as error:
            wrong = f"the workers do not start ({error}): a program starts them below if __name__ == '__main__':"
        except RuntimeError as error:
            wrong = f"the executor takes no work ({error}): give one that is open"
        else:
            others = [f"{where} has mdm {version}" for where, version in found.items() if version != __version__]
            wrong = f"{others[0]}, but here it is {__version__}: install the same" if others else ""
        if wrong:
            raise ConfigError(wrong, key="executor")
        if getattr(self._work.policy, "deliberates", False):
            most = getattr(self._work.policy, "memory", None)
            each = "each worker searches by itself" + (f", with up to {most / 1e6:.0f} MB" if most else "")
            text = f"{each}, and finds less where workers share a processor and its time"
            warnings.warn(text, WorkerWarning, stacklevel=4)

    def submit(self) -> bool:
        """Send as many parts as there is room for; return whether any are under way."""
        many = 2 * self._count or _UNKNOWN
        room = 1 if self._suspects else many if self._results else self._count or 1  # at first each lacks all
        while len(self.open) < room and not self._stopped:
            lacks: tuple[str, ...] = ()
            if self._again:
                units, lacks = self._again.popleft()
            elif self._next < self._work.units:
                share = math.ceil((self._work.units - self._next) / (self._count or 1))
                units = self._next, self._next + min(self._joined, share)
                self._next = units[1]
            else:
                break
            self._number += 1
            part = Part(*units, self._work.seed, self._needs, self._number)
            sent = {digest: self._content[digest] for digest in lacks}
            try:
                self.open[self._executor.submit(run_part, part, sent)] = units
            except RuntimeError as error:  # it is broken, or shut down
                self._again.append((units, lacks))
                if self.open:  # which tell the same
                    break
                self._end(error)
        return bool(self.open)

    def wait(self) -> None:
        """Wait a moment for parts, and take those that have ended."""
        done, _ = wait(self.open, 0.1, FIRST_COMPLETED)
        alone, broken = len(self.open) == 1, None
        for future in done:
            units = self.open.pop(future)
            try:
                answer = future.result()
            except (BrokenExecutor, CancelledError) as error:
                broken = error
                self._suspects.add(units)
                if alone and self._tries[units] >= _KILLED:
                    self._give_up(units, f"its worker was killed {_KILLED + 1} times")
                else:
                    self._tries[units] += alone
                    self._again.appendleft((units, ()))
            except Exception as error:  # the executor's own, such as of a worker that Dask has given up
                self._retry(units, f"{type(error).__name__}: {error}")
            else:
                self._take(units, answer)
        if broken is not None:
            self._end(broken)

    def _take(self, units: _Units, answer: Answer) -> None:
        worker = answer.worker
        if answer.lacks:
            self._again.append((units, answer.lacks))
        elif answer.failure:
            self._retry(units, answer.failure)
        else:
            self._suspects.discard(units)
            self._results[units] = answer.result
            self.done += self._work.size(*units)
            self._joined = max(1, int((units[1] - units[0]) * _LONG / max(worker.seconds, 1e-6)))
            key = worker.host, worker.process
            if (before := self._workers.get(key)) is not None:
                seconds = before.seconds + worker.seconds
                worker = msgspec.structs.replace(worker, parts=before.parts + 1, seconds=seconds)
            self._workers[key] = worker

    def _retry(self, units: _Units, reason: str) -> None:
        """Try a unit once more, and a part of more units by its halves."""
        first, last = units
        if last - first > 1:
            middle = (first + last) // 2
            self._again.extend([((first, middle), ()), ((middle, last), ())])
        elif self._tries[units]:
            self._give_up(units, reason)
        else:
            self._tries[units] = 1
            self._again.append((units, ()))

    def _give_up(self, units: _Units, reason: str) -> None:
        self._suspects.discard(units)
        self._failed[units] = reason
        if not self._results and len(self._failed) == _HOPELESS:
            self._stopped = reason

    def _end(self, error: BaseException) -> None:
        if isinstance(self._executor, Processes):
            self._executor.renew()
        else:  # a user's
            self._stopped = f"the executor has ended: {error}"

    def joined(self) -> _Result:
        """Return the results in order, and tell missing parts and hosts that differ."""
        if self._stopped:
            left = [*self.open.values(), *(units for units, _ in self._again), (self._next, self._work.units)]
            self._failed = dict.fromkeys([each for each in left if each[0] < each[1]], self._stopped) | self._failed
        missing = sum(self._work.size(*units) for units in self._failed)
        if missing:
            causes = dict.fromkeys(self._failed[units] for units in sorted(self._failed))
            told = f"{counted(missing, 'episode')} of seed {self._work.seed} are missing, from spawn key "
            told += f"({min(self._failed)[0]},) on"
            if not self._results:
                raise Error(f"no part has ended, {told}: {next(iter(causes))}")
            warnings.warn(f"{told}: {'; '.join(causes)}", WorkerWarning, stacklevel=4)
        workers = tuple(self._workers.values())
        for bit in ("numpy", "numba", "blas", "machine"):  # on which last bits depend
            hosts = {each.environment.get(bit, ""): each.host for each in workers}
            if len(hosts) > 1:
                differ = " and ".join(f"{version or 'none'} on {host}" for version, host in hosts.items())
                text = f"{bit} differs among workers, {differ}: the last bits may differ with who ran which part"
                warnings.warn(text, WorkerWarning, stacklevel=4)
        return [self._results[units] for units in sorted(self._results)], missing, workers


# -- Processes ---------------------------------------------------------------------------------------------------------


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
    """Leave Ctrl-C to the process that waits for them, and end with it; the simulation is loaded by then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end, daemon=True).start()


def _end() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
