"""The measurement: ways in which a stimulus comes, in turn, and a bare loop beside them.

Each row is measured in short slices, one after the other, so that the machine's moods are in all rows alike; with the
recorder and with the page, in a runtime of their own.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager, suppress
from functools import partial
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from mdm.actors import FixedRate
from mdm.checks import is_whole
from mdm.errors import Error
from mdm.latency.faster import faster
from mdm.latency.others import BUSY, LOOKER, putter, spawned
from mdm.latency.probe import Probe
from mdm.latency.report import Report, Row
from mdm.latency.subject import Subject
from mdm.runtime import Runtime, run
from mdm.runtime.time.clock import check_seconds
from mdm.views.web import Page

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

    from mdm.latency.subject import Given, Stimulus

LOOP, THREAD, PROCESS, BARE = "in the loop", "from a thread", "from another process", "a bare loop"
TICKS, RECORDED, SHOWN = "ticks, behind their time", f"{LOOP}, with the recorder", f"{LOOP}, with the page at 20 Hz"
_NEEDS = {PROCESS: ("zenoh", "eclipse-zenoh"), RECORDED: ("mcap", "mcap"), SHOWN: ("websockets", "websockets")}
_SLICE = 0.5
_WARM = 0.3
"""Seconds ahead of all in which kernels are compiled and caches filled."""
_PASSES = 5
"""Passes of the event loop in which a decision follows a stimulus, where nothing is searched and no tick awaited."""
_LATEST = 5.0
"""Seconds in which a stimulus from outside the loop must have come."""
_PAUSE = 0.0005
"""Seconds between stimuli from outside the loop, in which it falls asleep, as between those of sensors."""


def measure(
    given: Given,
    *,
    seconds: float = 50.0,
    burn: int = 0,
    agent: str | None = None,
    with_actions: bool = False,
    seed: int = 1,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> Report:
    """Measure how long decisions take: from a random stimulus to the first action that is called.

    No task, sensor, link or team runs, and stamps stand in for actions; policies and trackers are the file's own. A
    system or an ensemble that is given is not for use afterwards: it has stamps in place of its actions.

    Args:
        given: A system or an ensemble, the TOML file of a system, or a pair of a model and a policy.
        seconds: For how long in all, besides the start; it is divided among the rows.
        burn: Measure also beside so many busy processes.
        agent: Of a team's file, the agent whose own ensembles are measured.
        with_actions: Call the actions' own functions besides, many times a second.
        seed: Of the random stimuli.
        clock: The time in nanoseconds.

    Returns:
        A row for each way in which stimuli come. A row that an absent package would measure says so in its ``needs``.

    Raises:
        Error: If there is nothing to measure, or a number is none that may be.

    Example:
        >>> report = mdm.latency.measure("robot.toml", seconds=10)
        >>> report.row("in the loop").p99
    """
    check_seconds(seconds, "seconds")
    if not is_whole(burn) or burn < 0:
        raise Error(f"burn is a number of processes, 0 or more, not {burn!r}")
    subject = Subject(given, agent=agent, with_actions=with_actions, seed=seed)
    return run(_Measurement(subject, Probe(clock, with_actions=with_actions), seconds, burn, clock).run)


class _Measurement:
    """One measurement of one subject."""

    _stimulus: Stimulus

    def __init__(self, subject: Subject, probe: Probe, seconds: float, burn: int, clock: Callable[[], int]) -> None:
        self._subject, self._probe, self._seconds, self._burn, self._clock = subject, probe, seconds, burn, clock
        ensembles = subject.ensembles.values()
        rates = [drive.rate for each in ensembles if isinstance(drive := each.status().drive, FixedRate)]
        self._busy = f"{LOOP}, beside {burn} busy processes"
        names = [LOOP, THREAD, PROCESS, BARE, *([TICKS] if rates else []), *([self._busy] if burn else [])]
        self._found: dict[str, list[int]] = {name: [] for name in [*names, RECORDED, SHOWN]}
        self._by: dict[str, list[int]] = {path: [] for path in sorted(each.path for each in ensembles)}
        self._undecided, self._faults = Counter[str](), Counter[str]()
        self._absent = {name: package for name, (module, package) in _NEEDS.items() if find_spec(module) is None}
        self._share = seconds / len([name for name in self._found if name not in self._absent])
        searching = (each for each in ensembles if getattr(each.controller.policy, "deliberates", False))
        searches = [each.status().deadline or 1.0 for each in searching]
        self._patience = max([0.0, *(2 / rate for rate in rates), *searches])

    async def run(self) -> Report:
        """Measure all rows."""
        self._loop, self._arrived = asyncio.get_running_loop(), asyncio.Event()
        with ExitStack() as opened:
            outside: dict[str, Callable[[], object]] = {}
            outside[THREAD] = partial(opened.enter_context(ThreadPoolExecutor(1)).submit, self._give)
            if PROCESS not in self._absent:
                outside[PROCESS] = opened.enter_context(putter(self._give))
            async with self._running():
                await self._in_turn(outside)
                for _ in range(self._burn):
                    opened.enter_context(spawned(BUSY))
                if self._burn:
                    await self._in_loop(self._busy, self._share)
        if RECORDED not in self._absent:
            with TemporaryDirectory(prefix="mdm-latency-") as folder:
                async with self._running(record=Path(folder) / "run.mcap"):
                    await self._in_loop(RECORDED, self._share)
        if SHOWN not in self._absent:
            page = Page(0, announce=lambda _: None)
            async with self._running(page=page):
                with spawned(LOOKER, page.address):
                    await self._in_loop(SHOWN, self._share)
        hints = tuple(faster(self._subject.ensembles.values()))
        return Report(tuple(self._rows()), hints, dict(self._faults), self._seconds)

    def _rows(self) -> Iterator[Row]:
        for name, found in self._found.items():
            if name in self._absent:
                yield Row(name, needs=self._absent[name])
                continue
            yield Row.of(name, found, self._undecided[name])
            if name == LOOP and len(self._by) > 1:
                yield from (Row.of(f"{LOOP}: {path}", each) for path, each in self._by.items())

    @asynccontextmanager
    async def _running(self, **extensions: Any) -> AsyncIterator[None]:
        """Run the subject, warm."""
        async with Runtime(log=None, **extensions) as runtime:
            runtime.dispatcher.choices = self._probe
            runtime.faults.subscribe(lambda fault: self._faults.update({fault.kind} - {"livelock"}))  # which this is
            await self._subject.start(runtime)
            until = self._until(_WARM)
            while self._clock() < until:
                await self._decide()
            yield

    def _until(self, seconds: float) -> int:
        return self._clock() + round(seconds * 1e9)

    async def _in_turn(self, outside: dict[str, Callable[[], object]]) -> None:
        """Measure the comparable rows slice by slice."""
        turns = max(1, round(self._share / _SLICE))
        share = self._share / turns
        for _ in range(turns):
            self._subject.refresh()
            await self._in_loop(LOOP, share)
            for name, send in outside.items():
                await self._from_outside(name, send, share)
            await self._bare(share)
            if TICKS in self._found:
                self._probe.late = self._found[TICKS]
                await asyncio.sleep(share)
                self._probe.late = None

    async def _in_loop(self, name: str, seconds: float) -> None:
        """Give stimuli in the event loop, one after the other."""
        until = self._until(seconds)
        while self._clock() < until:
            await self._decide()
            self._take(name)
            await asyncio.sleep(0)

    async def _decide(self) -> None:
        """Give a stimulus in the event loop, which turns until it is decided."""
        stimulus, probe = self._subject.pick(), self._probe
        probe.at = None
        began = self._clock()
        stimulus()
        probe.began = began
        await self._decided()

    async def _from_outside(self, name: str, send: Callable[[], object], seconds: float) -> None:
        """Have stimuli given in another thread, one after the other, while the event loop sleeps."""
        until = self._until(seconds)
        while self._clock() < until:
            self._stimulus = self._subject.pick()
            self._arrived.clear()
            send()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._arrived.wait(), _LATEST)
                await self._decided()
                self._take(name)
            await asyncio.sleep(_PAUSE)

    def _give(self, began: int | None = None) -> None:
        """Give the stimulus that is next, in another thread; it began now, or where another process put it."""
        self._probe.at = None
        self._probe.began = self._clock() if began is None else began
        self._stimulus()
        self._loop.call_soon_threadsafe(self._arrived.set)

    async def _decided(self) -> None:
        """Wait until an action is called, or none will be."""
        until = time.monotonic() + self._patience
        for passes in count():
            if self._probe.at is not None or (passes > _PASSES and time.monotonic() >= until):
                return
            await asyncio.sleep(0 if passes <= _PASSES else _PAUSE)

    def _take(self, name: str) -> None:
        """Count the outcome of the last stimulus."""
        probe = self._probe
        if probe.at is None:
            self._undecided[name] += 1
            self._subject.recover()
            return
        self._found[name].append(probe.at - probe.began)
        if name == LOOP:
            self._by[probe.by].append(probe.at - probe.began)

    async def _bare(self, seconds: float) -> None:
        """Call a plain function by one queue of asyncio."""
        queue, at, until = asyncio.Queue[int](), [0], self._until(seconds)

        async def serve() -> None:
            while True:
                await queue.get()
                at[0] = self._clock()

        serving = asyncio.create_task(serve())
        while self._clock() < until:
            at[0], began = 0, self._clock()
            queue.put_nowait(1)
            while True:
                await asyncio.sleep(0)
                if at[0]:
                    break
            self._found[BARE].append(at[0] - began)
        serving.cancel()
