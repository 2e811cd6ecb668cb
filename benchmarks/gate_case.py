"""One commit's side of the gate: builds a case once, then measures a block of it for each line of standard input.

The process runs with the commit's tree in ``PYTHONPATH``, and so measures that tree's ``mdm``. With ``--quick`` there
are a tenth of the ensembles: to build a thousand takes seconds.
"""

from __future__ import annotations

import asyncio
import gc
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from decision_latency import Callback, Signalling, crowd, observing, ours, robot, robot_with_two, team

import mdm

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

DECTIGER = Path(__file__).parent / "data" / "dectiger.dpomdp"
now = time.perf_counter


def block(latency: Callable[[int], float], repeats: int) -> Callable[[], Awaitable[float]]:
    """Return what measures a block of decisions, one by one, and returns their median in microseconds."""

    async def measured() -> float:
        return statistics.median(latency(index) for index in range(repeats)) * 1e6

    return measured


async def mdp(runtime: mdm.Runtime, case: str) -> Callable[[], Awaitable[float]]:
    """Return the block of one ensemble on states, by one sensor or by two in a batch."""
    callback = Callback()
    ensemble, sensor, second = robot_with_two("mdp", callback)
    await runtime.start(ensemble)
    assert ensemble.predicates is not None
    by_one, by_two = ours(sensor, second, ensemble.predicates.batch, callback).values()
    return block(by_two if case == "batch" else by_one, 2000)


async def dectiger(runtime: mdm.Runtime, _: str) -> Callable[[], Awaitable[float]]:
    """Return the block of one ensemble on observations, with a belief."""
    callback = Callback()
    short = mdm.policies.AlphaVectors([[-2.0, -2.0], [-50.0, 20.0], [20.0, -50.0]], [0, 4, 8], 9)
    ensemble, heard = team(DECTIGER, short, callback)
    await runtime.start(ensemble)
    return block(observing(heard, callback), 1000)


async def ensembles(runtime: mdm.Runtime, case: str) -> Callable[[], Awaitable[float]]:
    """Return the block of many ensembles on one predicate manager: processor time of a decision."""
    setters = await crowd(runtime, int(case), shared=True)
    passes = max(2, 3000 // len(setters) // 2 * 2)

    async def measured() -> float:
        began = time.process_time()
        for index in range(passes):
            value = index % 2 == 0
            for setter in setters:
                setter(value)
        return (time.process_time() - began) / (passes * len(setters)) * 1e6

    return measured


async def thread(runtime: mdm.Runtime, _: str) -> Callable[[], Awaitable[float]]:
    """Return the block of a sensor that a thread sets while the event loop waits."""
    callback = Signalling()
    ensemble, sensor = robot("threaded", callback)
    await runtime.start(ensemble)
    callback.called = threading.Semaphore(0)  # the start decides, too

    def latency(index: int) -> float:
        began = now()
        sensor.set(index % 2 == 0)
        callback.called.acquire()
        time.sleep(0.0005)  # as sensors do: a loop that is awake already would be no fair start
        return callback.at - began

    async def measured() -> float:
        return statistics.median(await asyncio.to_thread(lambda: [latency(index) for index in range(150)])) * 1e6

    return measured


CASES = {"mdp": mdp, "batch": mdp, "dectiger": dectiger, "300": ensembles, "1000": ensembles, "thread": thread}
RECORDED = "recorded"


async def main(case: str, *, quick: bool) -> None:
    """Answer each line with what a block costs."""
    with tempfile.TemporaryDirectory() as folder:
        recorded = {"record": Path(folder) / "gate.mcap"} if case == RECORDED else {}
        async with mdm.Runtime(log=None, **recorded) as runtime:
            measured = await CASES.get(case, mdp)(runtime, case[:-1] if quick and case.isdigit() else case)
            await measured()  # warms up
            print("ready", flush=True)
            while await asyncio.to_thread(sys.stdin.readline):
                gc.collect()
                print(await measured(), flush=True)
                if recorded:
                    await asyncio.sleep(0.1)  # what was noted is written by then


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], quick="--quick" in sys.argv))
