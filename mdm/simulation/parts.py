"""Long work in parts, on any `concurrent.futures.Executor`: on processes here, on other machines, in any order.

A work is a number of units, such as episodes. A part is some consecutive units, joined until they take a second;
`run_part` runs one anywhere. Results are joined in the order of units: they depend on the work and its seed alone, not
on how many workers there are, which parts ended first or ran twice. A model, and a work with it, travel once to each
worker: a part has their digests, a worker that lacks one says so, and is sent it with the part.
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
from collections import Counter, defaultdict, deque
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor, wait
from functools import cache
from pkgutil import resolve_name
from types import FunctionType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import msgspec

from mdm.beliefs.choice import free_memory
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
"""How often a unit that runs alone may lose its worker and is run again."""
_PROCESSES = 1_000
"""Processes on one machine: of more somebody has mistyped the number."""
_HOPELESS = 10
"""Units that fail, before any part has ended, after which there are no more."""
_VERSION = "mdm.version:__version__"


class WorkerWarning(UserWarning):
    """Something of parts that run on workers: some are missing, hosts differ, or each worker searches by itself."""


class Work(Protocol):
    """Work that has parts: units in a model, which travels by itself; unit n draws by the seed's spawn key (n,)."""

    model: Any
    policy: Any
    seed: int
    units: int

    def size(self, first: int, last: int) -> int:
        """Return how many episodes these units are; with a ``noun``, each is one such and a part of its own."""

    def prepare(self) -> None:
        """Make all that its units share, once in each worker."""

    def run(self, first: int, last: int, tell: Callable[[int], bool] = lambda _: False) -> Any:
        """Run these units; told how many episodes have ended, `tell` returns True to have the result of those alone."""


class Part(NamedTuple):
    """The units of a work from a first to before a last; the digests of its model and of all else; mdm's version."""

    first: int
    last: int
    needs: tuple[str, str]
    version: str = __version__


class Worker(msgspec.Struct, frozen=True):
    """A process: its host and number, the versions of its libraries, how many parts it ran, and their seconds."""

    host: str
    process: int
    environment: dict[str, str]
    parts: int = 0
    seconds: float = 0.0


class Answer(NamedTuple):
    """The end of a part: its result after some seconds, or the digests that its worker lacks, or why it failed."""

    worker: Worker
    result: Any = None
    seconds: float = 0.0
    lacks: tuple[str, ...] = ()
    failure: str = ""


# -- At the worker -----------------------------------------------------------------------------------------------------

_held = threading.local()
"""The last model and work of each thread, by digest: works hold things of their own, such as random numbers."""


def run_part(part: Part, sent: Mapping[str, bytes]) -> Answer:
    """Run a part here, with the content sent with it or before; its seconds are those of its units alone."""
    worker, held, (model, work) = _here(), _held.__dict__, part.needs
    if part.version != __version__:
        failure = f"{worker.host} has mdm {__version__}, and the part is of {part.version}: install the same"
        return Answer(worker, failure=failure)
    if lacks := tuple(digest for digest in part.needs if digest not in held and digest not in sent):
        return Answer(worker, lacks=lacks)
    try:
        if model not in held:
            held.clear()
            held[model] = pickle.loads(sent[model])  # noqa: S301 - its program's own
        if work not in held:
            for other in held.keys() - {model}:
                del held[other]
            reader = _Reader(io.BytesIO(sent[work]))
            reader.model = held[model]
            loaded = reader.load()
            loaded.prepare()
            held[work] = loaded
        began = time.perf_counter()
        result = held[work].run(part.first, part.last)
        return Answer(worker, result, time.perf_counter() - began)
    except Error as error:
        failure = str(error)
    except ModuleNotFoundError as error:
        failure = f"{worker.host} has no module {error.name!r}: put it where the workers import modules from"
    except Exception as error:
        failure = f"{type(error).__name__}: {error}\n{traceback.format_exc().rstrip()}"
    return Answer(worker, failure=failure)


@cache
def _here() -> Worker:
    from mdm.recording.recorder import environment  # noqa: PLC0415 - loaded where parts are run

    return Worker(socket.gethostname(), os.getpid(), environment())


class _Reader(pickle.Unpickler):
    model: Any

    def persistent_load(self, _: Any) -> Any:
        return self.model


class _Writer(pickle.Pickler):
    """Pickles without the model, which travels by itself, and refuses names that a worker could not import."""

    model: Any = _held  # which nothing holds

    def persistent_id(self, given: Any) -> str | None:
        return "model" if given is self.model else None

    def reducer_override(self, given: Any) -> Any:
        if isinstance(given, type | FunctionType) and given.__module__ == "__main__":
            raise ConfigError(f"{given.__qualname__} is in the program itself: put it into a module that it imports")
        return NotImplemented


def _packed(given: Any, name: str, model: Any = _held) -> bytes:
    buffer = io.BytesIO()
    writer = _Writer(buffer, protocol=5)
    writer.model = model
    try:
        writer.dump(given)
    except Exception as error:
        raise ConfigError(f"{name} cannot be sent to workers: {error}", key="executor") from error
    return buffer.getvalue()


# -- At the one who waits ----------------------------------------------------------------------------------------------


def run_parts(
    work: Work,
    executor: Executor | None = None,
    progress: Callable[[int, int], object] | None = None,
    keep: Callable[[Any], object] = lambda _: None,
) -> tuple[list[Any], int, tuple[Worker, ...]]:
    """Run a work to its end.

    Args:
        work: The work.
        executor: Who runs its parts; None for this process, at once.
        progress: Called with how many episodes have ended, and of how many, ten times a second with an executor; where
            it returns True, the results are those known by then.
        keep: Called with the result of each part of an executor as soon as that is known.

    Returns:
        The results of parts in the order of units, how many episodes have none, since their part failed, and who ran
        the parts.

    Raises:
        ConfigError: If the executor is none, takes no work, cannot be sent this work, has a worker with no mdm or with
            another version, or its processes would search with more memory than the machine has free.
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
    run = _Run(work, executor, keep)
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

    def __init__(self, work: Work, executor: Executor, keep: Callable[[Any], object]) -> None:
        self._work, self._executor, self._keep = work, executor, keep
        self._dask: Any = getattr(executor, "_client", None)
        self._versions: dict[str, Any] = {}  # of Dask's workers
        self._count: int = getattr(executor, "workers", 0) or getattr(executor, "_max_workers", 0)
        self._check()
        self._warn_of_search()
        content = _packed(work.model, "the model"), _packed(work, "the policy", work.model)
        model = of_bytes(content[0])
        self._needs = model, of_bytes(model.encode() + content[1])
        self._content = dict(zip(self._needs, content, strict=True))
        self._next = self.done = 0
        self._joined, self._alone, self._stopped = 1, False, ""
        self.open: dict[Future[Answer], _Units] = {}
        self._again: deque[_Units] = deque()
        self._lacked: defaultdict[_Units, set[str]] = defaultdict(set)  # by all workers that these have come to
        self._tries: Counter[_Units] = Counter()
        self._results: dict[_Units, Any] = {}
        self._failed: dict[_Units, str] = {}
        self._workers: dict[tuple[str, int], Worker] = {}

    def _check(self, *, again: bool = False) -> None:
        """Refuse workers before the first part."""
        others, wrong = [], ""
        try:
            if self._dask is not None:
                others = self._others()
            elif (version := self._executor.submit(resolve_name, _VERSION).result()) != __version__:
                others = [f"a worker has mdm {version}"]
        except ImportError as error:
            others = [f"a worker has no mdm ({error})"]
        except BrokenExecutor as error:
            if isinstance(self._executor, Processes) and not again:  # one was killed before, or as it began
                self._executor.renew()
                self._check(again=True)
                return
            wrong = f"the workers do not start ({error}): a program starts them below if __name__ == '__main__':"
        except RuntimeError as error:
            wrong = f"the executor takes no work ({error}): give one that is open"
        if others:
            wrong = f"{others[0]}, but here it is {__version__}: install the same"
        if wrong:
            raise ConfigError(wrong, key="executor")

    def _warn_of_search(self) -> None:
        """Say how much memory searches may take; refuse more than this machine has free."""
        policy, many, free = self._work.policy, self._count or _UNKNOWN, free_memory()
        if not getattr(policy, "deliberates", False):
            return
        most = many * getattr(getattr(policy, "policy", policy), "memory", 0)
        text = f"each worker searches by itself, {many} of them with up to {most / 1e6:.0f} MB"
        if isinstance(self._executor, Processes) and free is not None and most > free:
            text += f", but the machine has {free / 1e6:.0f} MB free: give fewer workers, or the search less memory"
            raise ConfigError(text, key="executor")
        warnings.warn(f"{text}; it finds less where workers share a processor", WorkerWarning, stacklevel=4)

    def _others(self) -> list[str]:
        """Ask Dask's workers, of which some may be new, for their version; name new ones that have another."""
        count = self._dask.nthreads()
        self._count = sum(count.values())
        if not (new := [name for name in count if name not in self._versions]):
            return []
        found = self._dask.run(resolve_name, _VERSION, workers=new, on_error="return")
        found = {name: its for name, its in found.items() if isinstance(its, str | ImportError)}  # of those still there
        self._versions |= found
        text = {name: f"mdm {its}" if isinstance(its, str) else f"no mdm ({its})" for name, its in found.items()}
        return [f"{name} has {text[name]}" for name, its in found.items() if its != __version__]

    def submit(self) -> bool:
        """Send as many parts as there is room for; return whether any are under way."""
        named: dict[str, Any] = {}
        if self._dask is not None:
            try:
                others = self._others()
            except OSError as error:  # the scheduler's end, after which no part comes back
                self._end(error)
                return False
            for other in others:
                warnings.warn(f"{other}, but here it is {__version__}: it gets no parts", WorkerWarning, stacklevel=4)
            good = [name for name, version in self._versions.items() if version == __version__]
            few = {} if len(good) == len(self._versions) else {"workers": good, "allow_other_workers": True}
            named = {"pure": False, **few}
        self._alone = self._alone and bool(self._again or self.open)
        many = 2 * self._count or _UNKNOWN if self._results else self._count or 1  # at first each lacks all
        while len(self.open) < (1 if self._alone else many) and not self._stopped:
            if self._again:
                units = self._again.popleft()
            elif self._next < self._work.units:
                share = math.ceil((self._work.units - self._next) / (self._count or 1))
                units = self._next, self._next + min(self._joined, share)
                self._next = units[1]
            else:
                break
            sent = {digest: self._content[digest] for digest in self._lacked.get(units, ())}
            try:
                self.open[self._executor.submit(run_part, Part(*units, self._needs), sent, **named)] = units
            except RuntimeError as error:  # it is broken, or shut down
                self._again.append(units)
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
            except (BrokenExecutor, CancelledError) as error:  # of all parts, whichever killed its worker
                broken = error
                if alone:
                    self._retry(units, f"its worker was killed {_KILLED + 1} times", _KILLED)
                else:
                    self._again.appendleft(units)
            except Exception as error:  # the executor's own, such as of a worker that Dask has given up
                self._retry(units, f"{type(error).__name__}: {error}")
            else:
                self._take(units, answer)
        if broken is not None:
            self._alone = True
            self._end(broken)

    def _take(self, units: _Units, answer: Answer) -> None:
        its = answer.worker
        if answer.lacks or (self._dask is not None and its.environment["mdm"] != __version__):  # which came late
            self._lacked[units].update(answer.lacks)
            self._again.append(units)
        elif answer.failure:
            self._retry(units, answer.failure)
        else:
            self._results[units] = answer.result
            self._keep(answer.result)
            self.done += self._work.size(*units)
            if not hasattr(self._work, "noun"):
                self._joined = max(1, int((units[1] - units[0]) * _LONG / max(answer.seconds, 1e-6)))
            its = self._workers.get((its.host, its.process), its)
            more = msgspec.structs.replace(its, parts=its.parts + 1, seconds=its.seconds + answer.seconds)
            self._workers[its.host, its.process] = more

    def _retry(self, units: _Units, reason: str, most: int = 1) -> None:
        """Try a part of one unit again, at most so often, and a part of more units by its halves."""
        first, last = units
        if last - first > 1:
            middle = (first + last) // 2
            self._again.extend([(first, middle), (middle, last)])
        elif self._tries[units] < most:
            self._tries[units] += 1
            self._again.append(units)
        else:
            self._failed[units] = reason
            if not self._results and len(self._failed) == _HOPELESS:
                self._stopped = reason

    def _end(self, error: BaseException) -> None:
        if isinstance(self._executor, Processes):
            self._executor.renew()
        else:  # a user's
            self._stopped = f"the executor has ended: {error}"

    def joined(self) -> tuple[list[Any], int, tuple[Worker, ...]]:
        """Return the results in order, and tell missing parts and hosts that differ."""
        if self._stopped:
            left = [*self.open.values(), *self._again, (self._next, self._work.units)]
            self._failed = {units: self._stopped for units in left if units[0] < units[1]} | self._failed
        missing = sum(self._work.size(*units) for units in self._failed)
        if missing:
            told = f"{counted(missing, getattr(self._work, 'noun', 'episode'))} of seed {self._work.seed}"
            told += f" {'is' if missing == 1 else 'are'} missing, the first at spawn key ({min(self._failed)[0]},): "
            told += "; ".join(dict.fromkeys(self._failed[units] for units in sorted(self._failed)))
            if not self._results:
                raise Error(f"no part has ended, {told}")
            warnings.warn(told, WorkerWarning, stacklevel=4)
        workers = tuple(self._workers.values())
        for bit in ("numpy", "numba", "blas", "machine"):  # on which last bits depend
            hosts = {each.environment.get(bit, ""): each.host for each in workers}
            if len(hosts) > 1:
                differ = " and ".join(f"{version or 'none'} on {host}" for version, host in hosts.items())
                text = f"{bit} differs among workers, {differ}: the last bits may differ with who ran which part"
                warnings.warn(text, WorkerWarning, stacklevel=4)
        return [self._results[units] for units in sorted(self._results)], missing, workers


# -- Processes ---------------------------------------------------------------------------------------------------------


class Processes(ProcessPoolExecutor):
    """Processes of this machine, for the ``executor`` of a simulation: they go on where one of them is killed.

    They start when there is work, and stay for the next; Ctrl-C is left to the process that made them, with which they
    end.

    Args:
        workers: How many; by default as many as there are processors.

    Raises:
        ConfigError: If that is no whole number from 1 to 1,000.

    Example::

        def value(model, policy):
            with mdm.simulation.Processes(4) as workers:
                return mdm.evaluate(model, policy, episodes=1_000_000, executor=workers).mean
    """

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and not (is_whole(workers) and 1 <= workers <= _PROCESSES):
            raise ConfigError(f"give 1 to {_PROCESSES:,} processes, a whole number, not {workers!r}", key="workers")
        here = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
        self.workers = workers or here or 1
        spawn = multiprocessing.get_context("spawn")  # a fork would have the locks of this process' threads
        super().__init__(self.workers, spawn, initializer=_begin)

    def renew(self) -> None:
        """End the processes in the middle of their parts; others start with the next work."""
        for process in list((getattr(self, "_processes", None) or {}).values()):
            process.kill()
        self.shutdown(cancel_futures=True)
        Processes.__init__(self, self.workers)


def _begin() -> None:
    """Leave Ctrl-C to the process that waits for them, and end with it; the simulation is loaded by then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end, daemon=True).start()


def _end() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
