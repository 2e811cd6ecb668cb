"""What a record costs: sensor to callback at 1,000 decisions a second, and the loop's share of a core at 10,000.

Two runtimes of one process, of which one records as by default; they take turns, so that the machine's moods hit both
alike. The process that writes the file counts apart.
"""

from __future__ import annotations

import asyncio
import gc
import resource
import statistics
import tempfile
import time
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from decision_latency import Callback, robot
from measurement import arguments, quantiles, report, table

import mdm

if TYPE_CHECKING:
    from collections.abc import Mapping

now = time.perf_counter
ALONE, RECORDED = "alone", "recorded"


async def paced(sensor: mdm.Sensor, callback: Callback, count: int, rate: float, at_once: int) -> list[float]:
    """Decide so many times at a rate, some at once, and return the latencies."""
    loop, latencies = asyncio.get_running_loop(), []
    due = loop.time()
    for first in range(0, count, at_once):
        due += at_once / rate
        await asyncio.sleep(due - loop.time())
        for index in range(first, min(first + at_once, count)):
            began = now()
            sensor.set(index % 2 == 0)
            latencies.append(callback.at - began)
    return latencies


async def latency(cases: Mapping[str, tuple[mdm.Sensor, Callback]], rounds: int, count: int) -> list[dict[str, Any]]:
    """Measure from sensor to callback at 1,000 decisions a second, as they come to robots: one by one."""
    found: dict[str, list[float]] = {name: [] for name in cases}
    for turn in range(rounds + 1):  # the first warms up
        for name, case in cases.items():
            gc.collect()
            measured = await paced(*case, count, 1000.0, 1)
            if turn:
                found[name] += measured
    base = statistics.median(found[ALONE])
    return [
        {"case": name, **quantiles(each), "times alone": statistics.median(each) / base} for name, each in found.items()
    ]


async def share(cases: Mapping[str, tuple[mdm.Sensor, Callback]], rounds: int, count: int) -> list[dict[str, Any]]:
    """Measure the share of a core at 10,000 decisions a second, ten each millisecond, encoding included."""
    found: dict[str, list[float]] = {name: [] for name in cases}
    for turn in range(rounds + 1):
        for name, case in cases.items():
            gc.collect()
            began = time.thread_time()
            await paced(*case, count, 10_000.0, 10)
            await asyncio.sleep(0.2)  # what was noted is encoded by then
            if turn:
                found[name].append((time.thread_time() - began) / (count / 10_000.0))
    base = statistics.median(found[ALONE])
    return [
        {"case": name, "share of a core": statistics.median(each), "times alone": statistics.median(each) / base}
        for name, each in found.items()
    ]


async def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    rounds, count = (1, 50) if given.quick else (15, 1000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        async with AsyncExitStack() as stack:
            cases = {}
            for name, record in ((ALONE, None), (RECORDED, path)):
                runtime = await stack.enter_async_context(mdm.Runtime(log=None, record=record))
                callback = Callback()
                ensemble, sensor = robot(name, callback)
                await runtime.start(ensemble)
                cases[name] = sensor, callback
            slow = await latency(cases, rounds, count)
            fast = await share(cases, max(1, rounds // 2), 10 * count)
            assert runtime.recorder is not None
            kept = runtime.recorder.statistics()
        decisions = (rounds + 1) * count + (max(1, rounds // 2) + 1) * 10 * count
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        written = [
            {
                "decisions": decisions,
                "messages": kept.messages,
                "dropped": kept.dropped,
                "bytes a decision": path.stat().st_size / decisions,
                "the writer's processor us a decision": (used.ru_utime + used.ru_stime) / decisions * 1e6,
            }
        ]
    table("Stimulus to first line of the callback, at 1,000 decisions a second", slow)
    table("The loop's share of a core, at 10,000 decisions a second", fast)
    table("What was written", written)
    report("recording", {"latency": slow, "share": fast, "written": written}, given.output)


if __name__ == "__main__":
    asyncio.run(main())
