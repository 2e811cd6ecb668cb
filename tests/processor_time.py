"""Processor seconds of each test, its children included, and a limit on them.

``pytest --processor-limit 2`` fails each test of the default ring that takes more, and lists the costliest in the
summary. The limit is for the machine on which the suite was tuned: a loop that every worker times at its start, and
again behind a test that took more, says how much slower this one is. Wall time is not looked at: it depends on what
else runs.
"""

from __future__ import annotations

import os
import resource
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

LISTED = 20
"""How many of the costliest tests the summary lists."""

_LOOP = 200_000
_LOOP_SECONDS = 0.0058
"""What the calibration loop takes on the machine for which the limit is meant, when nothing else runs there."""

_SELF = Path("/proc/self")
_TICK = 1.0 / os.sysconf("SC_CLK_TCK")

_uncharged = 0.0


def slowness() -> float:
    """How many times longer this machine takes than the one on which the suite was tuned; at least 1."""
    best = float("inf")
    for _ in range(5):
        begin = time.process_time()
        total = 0
        for number in range(_LOOP):
            total += number & 3
        best = min(best, time.process_time() - begin)
    return max(1.0, best / _LOOP_SECONDS)


def _children(process: Path) -> list[str]:
    found: list[str] = []
    try:
        for thread in (process / "task").iterdir():
            found += (thread / "children").read_text().split()
    except OSError:  # it has just ended, or this system does not tell
        pass
    return found


def _of_running(number: str) -> float:
    """Return what a running process has taken, with what it has waited for, and with its own running children."""
    process = Path("/proc", number)
    try:
        fields = (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) * _TICK + sum(map(_of_running, _children(process)))


def taken() -> float:
    """Processor seconds of this process and of all its children, those that still run included where /proc tells."""
    own, waited = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    ended = own.ru_utime + own.ru_stime + waited.ru_utime + waited.ru_stime
    return ended + sum(map(_of_running, _children(_SELF)))


@contextmanager
def uncharged() -> Iterator[None]:
    """Charge what is done within to no test: work that the first test of a session does for all."""
    global _uncharged  # noqa: PLW0603 - a session has one account
    begin = taken()
    try:
        yield
    finally:
        _uncharged += taken() - begin


class Limit:
    """A plugin that measures each test from its set-up to the end of its tear-down."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.costs: list[tuple[float, str]] = []
        self._slowness = 1.0
        self._begin = 0.0

    def pytest_sessionstart(self) -> None:
        """Time the calibration loop."""
        self._slowness = slowness()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self) -> Iterator[None]:
        """Begin to measure a test."""
        self._begin = taken() - _uncharged
        yield

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        """Fail a test of the default ring that took more than the limit."""
        yield
        seconds = taken() - _uncharged - self._begin
        cost = seconds / self._slowness
        if cost > self.seconds:  # a machine that others share may have become slower since the start
            cost = seconds / max(self._slowness, slowness())
        self.costs.append((cost, item.nodeid))
        if cost > self.seconds and item.get_closest_marker("slow") is None:
            text = f"{cost:.2f} processor seconds, where a test of the default ring may take {self.seconds:g}"
            pytest.fail(f"{text}: make it cheaper, or mark it slow and keep a smaller one", pytrace=False)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Hand the costs of a worker to the process that writes the summary."""
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["processor_seconds"] = self.costs

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object) -> None:
        """Take the costs of a worker."""
        self.costs += map(tuple, getattr(node, "workeroutput", {}).get("processor_seconds", ()))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """List the costliest tests."""
        total = sum(cost for cost, _ in self.costs)
        terminalreporter.section(f"processor seconds: {total:.0f} in {len(self.costs)} tests")
        for cost, test in sorted(self.costs, reverse=True)[:LISTED]:
            terminalreporter.write_line(f"{cost:6.2f} {test}")
