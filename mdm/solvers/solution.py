"""A solver's run: its limits, how far it has come, and its result, a policy with the bounds that certify it."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import msgspec
import numpy as np

from mdm.compilation import working_time
from mdm.errors import ConfigError, ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType, TracebackType

_Solver = TypeVar("_Solver", bound="Callable[..., Solution]")

Reason = Literal["gap", "time", "iterations", "memory", "interrupted", "converged", "exact"]
_KEPT = 0.05
"""Seconds between entries of the history, as a share of the time so far."""


class Progress(msgspec.Struct, frozen=True):
    """How far a solver has come.

    Attributes:
        seconds: Since it began.
        lower: A lower bound of the value of the policy found so far at the initial belief; -inf while nothing is known.
        upper: An upper bound of the value of any policy there; inf while nothing is known.
        iterations: Sweeps, trials or rounds, as the solver counts them.
        size: How large the policy is: vectors, nodes or states.
        memory: Bytes that the process holds.
    """

    seconds: float
    lower: float
    upper: float
    iterations: int
    size: int
    memory: int

    @property
    def gap(self) -> float:
        """How far the bounds are apart."""
        return self.upper - self.lower


class Solution(msgspec.Struct, frozen=True):
    """A policy with its certificate.

    Attributes:
        policy: The policy.
        solver: Which solver made it.
        lower: A lower bound of the policy's value at the initial belief; -inf where the solver proves nothing.
        upper: An upper bound of any policy's value there; inf where the solver proves nothing.
        reason: Why the solver stopped: the ``gap`` asked for was reached, the ``time``, the ``iterations`` or the
            ``memory`` allowed were used up, it was ``interrupted``, it has ``converged`` and would find nothing better,
            or the result is ``exact``.
        history: The progress, in order of time; the last entry is the result.
    """

    policy: Any
    solver: str
    lower: float
    upper: float
    reason: Reason
    history: tuple[Progress, ...]

    def __repr__(self) -> str:
        """Return the certificate, without the history."""
        return (
            f"Solution({self.policy!r}, {self.solver}, value {self.lower:.6g} to {self.upper:.6g}, "
            f"{self.iterations} iterations in {self.seconds:.3g} s, stopped: {self.reason})"
        )

    @property
    def gap(self) -> float:
        """How far the bounds are apart."""
        return self.upper - self.lower

    @property
    def seconds(self) -> float:
        """How long it took."""
        return self.history[-1].seconds

    @property
    def iterations(self) -> int:
        """How many sweeps, trials or rounds it took."""
        return self.history[-1].iterations


def makes(policy: type, *, to_horizon: type | None = None, mixed: type | None = None) -> Callable[[_Solver], _Solver]:
    """Declare the class of a solver's policies.

    Args:
        policy: The class.
        to_horizon: That of plans to a horizon, if it is another.
        mixed: That for models whose observations include factors of the state, if it is another.
    """

    def declare(solver: _Solver) -> _Solver:
        vars(solver)["policies"] = (policy, to_horizon or policy, mixed or policy)
        return solver

    return declare


class Limits:
    """Limits of a solver's run, and where it reports.

    It is a context: inside it the first Ctrl-C stops the solver, which returns the best policy that it has, and the
    second is a `KeyboardInterrupt` as ever (in the main thread; elsewhere call `interrupt`).

    Args:
        gap: Stop when the bounds at the initial belief are no further apart.
        time: Stop after so many seconds; None sets no limit.
        iterations: Stop after so many sweeps, trials or rounds.
        memory: Stop when the process holds so many bytes; by default 80 % of the machine's memory.
        progress: Called with each `Progress` that is reported; where it returns True, the run is interrupted.
        clock: Returns seconds; by default those that pass but for compilation.

    Raises:
        ConfigError: If a limit is no number from 0 on.
    """

    def __init__(
        self,
        *,
        gap: float = 1e-3,
        time: float | None = None,
        iterations: int | None = None,
        memory: int | None = None,
        progress: Callable[[Progress], object] | None = None,
        clock: Callable[[], float] = working_time,
    ) -> None:
        for name, limit in (("gap", gap), ("time", time), ("iterations", iterations), ("memory", memory)):
            if limit is not None and not (isinstance(limit, int | float | np.integer | np.floating) and limit >= 0):
                raise ConfigError(f"{name} is a number from 0 on, not {limit!r}", key=name)
        self.gap = float(gap)
        self.reason: Reason | None = None
        self._time = float("inf") if time is None else time
        self._iterations = sys.maxsize if iterations is None else iterations
        self._memory = int(0.8 * _machine_memory()) if memory is None else memory
        self._progress = progress
        self._clock = clock
        self._began = clock()
        self._history: list[Progress] = []
        self._interrupted = False
        self._previous: Any = None
        self._entered = 0

    def __enter__(self) -> Self:
        self._entered += 1
        if self._entered > 1:  # by a solver within a program's own block: that block's time and signals count
            return self
        self._began = self._clock()
        ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # by a shell that runs this in the background
        if threading.current_thread() is threading.main_thread() and not ignored:
            self._previous = signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._entered -= 1
        if self._entered == 0 and self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)
            self._previous = None

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True

    def interrupt(self) -> None:
        """Stop the solver at its next report; from any thread."""
        self._interrupted = True

    @property
    def seconds(self) -> float:
        """How long the solver has run."""
        return self._clock() - self._began

    @property
    def remaining(self) -> float:
        """How many seconds it has left; below 0 where they are used up or it was interrupted."""
        return -1.0 if self._interrupted else self._time - self.seconds

    @property
    def end(self) -> float:
        """The seconds of its run at which its time is up; infinite without a limit."""
        return float(self._time)

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """Let the time that passes within count for nothing, such as that of a compiler."""
        began = self._clock()
        try:
            yield
        finally:
            self._began += self._clock() - began

    def part(self, share: float) -> Callable[[], bool]:
        """Return a function that tells whether there is time left of a share of the present rest."""
        return self.until(self.seconds + share * self.remaining)

    def until(self, end: float) -> Callable[[], bool]:
        """Return a function that tells whether so many seconds of the run have not passed yet."""
        return lambda: not self._interrupted and self.seconds < end

    @property
    def room(self) -> int:
        """How many more bytes the process may hold, at least 0."""
        return max(0, self._memory - _held())

    def allows(self, size: int) -> bool:
        """Whether so many more bytes may be allocated; else the run ends at its next report, for lack of memory."""
        if size < self.room:
            return True
        self.reason = "memory"
        return False

    def ends(self, lower: float, upper: float, *, iterations: int, size: int) -> bool:
        """Report how far the solver has come; return whether it must stop, and keep why in ``reason``.

        Args:
            lower: The bound below, at the initial belief.
            upper: The bound above.
            iterations: Sweeps, trials or rounds so far.
            size: Vectors, nodes or states of the policy so far.

        Raises:
            ModelError: If the bounds are no numbers.
        """
        if lower != lower or upper != upper:  # noqa: PLR0124 - NaN
            raise ModelError(
                "the value of the initial belief is not a number: the model's rewards or numbers are too large"
            )
        report = Progress(self.seconds, lower, upper, iterations, size, _held())
        last = self._history[-1] if self._history else None
        if last is None or report.seconds - last.seconds >= _KEPT * last.seconds:
            self._history.append(report)
        if self._progress is not None and self._progress(report) is True:
            self._interrupted = True
        if upper - lower <= self.gap:
            self.reason = "gap"
        elif self.reason is not None:
            return True
        elif self._interrupted:
            self.reason = "interrupted"
        elif report.seconds >= self._time:
            self.reason = "time"
        elif iterations >= self._iterations:
            self.reason = "iterations"
        elif report.memory >= self._memory:
            self.reason = "memory"
        return self.reason is not None

    def solution(
        self, policy: Any, solver: str, lower: float, upper: float, *, iterations: int, size: int, exact: bool = False
    ) -> Solution:
        """Return a solver's result; where nothing stopped it, it is exact."""
        last = Progress(self.seconds, lower, upper, iterations, size, _held())
        reason: Reason = "exact" if exact or self.reason is None else self.reason
        return Solution(policy, solver, lower, upper, reason, (*self._history, last))


def _held() -> int:
    """Return how many bytes the process holds; on systems that do not tell, the most that it ever held."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return int(pages) * resource.getpagesize()


def _machine_memory() -> int:
    """Return how many bytes the machine has, or the control group that the process runs in."""
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
    except OSError:
        return physical
    return min(physical, int(limit)) if limit.isdecimal() else physical
