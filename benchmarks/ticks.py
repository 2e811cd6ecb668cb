"""How late fixed-rate ticks come: ours, the event loop's timers, a relative sleep; idle and beside a busy core."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from measurement import arguments, quantiles, report, table

import mdm

if TYPE_CHECKING:
    from mdm.messages import Tick

BUSY = "while True: pass"


async def ours(rate: float, count: int) -> list[float]:
    """Ticks of an actor."""
    late: list[float] = []
    done = asyncio.Event()
    async with mdm.Runtime(log=None) as runtime:
        actor = mdm.Actor("ticks")
        await runtime.start(actor)

        def tick(tick: Tick) -> None:
            late.append((runtime.clock.now() - tick.time) / 1e9)
            if len(late) >= count:
                done.set()

        actor.every(rate, tick)
        await done.wait()
    return late[:count]


async def call_at(rate: float, count: int) -> list[float]:
    """``loop.call_at`` at absolute times, which does not drift."""
    loop = asyncio.get_running_loop()
    late: list[float] = []
    done = asyncio.Event()
    began = loop.time()

    def tick(number: int) -> None:
        late.append(loop.time() - (began + number / rate))
        if number == count:
            done.set()
        else:
            loop.call_at(began + (number + 1) / rate, tick, number + 1)

    loop.call_at(began + 1 / rate, tick, 1)
    await done.wait()
    return late


async def sleep(rate: float, count: int) -> list[float]:
    """A relative ``asyncio.sleep``, as it is often written: it drifts, so its lateness grows."""
    began = time.monotonic()
    late = []
    for number in range(1, count + 1):
        await asyncio.sleep(1 / rate)
        late.append(time.monotonic() - (began + number / rate))
    return late


WAYS = {"mdm": ours, "loop.call_at": call_at, "asyncio.sleep": sleep}


def measure(rate: float, seconds: float, busy: bool, uvloop: bool) -> list[dict[str, Any]]:
    """Measure the three ways in turn."""
    child = subprocess.Popen([sys.executable, "-c", BUSY]) if busy else None
    rows = []
    try:
        for name, way in WAYS.items():
            count = max(3, int(rate * seconds))
            late = mdm.run(lambda way=way, count=count: way(rate, count), uvloop=uvloop)  # type: ignore[misc]
            drift = (late[-1] - late[0]) / (count / rate)
            rows.append(
                {
                    "rate_hz": rate,
                    "machine": "busy core" if busy else "idle",
                    "loop": "uvloop" if uvloop else "asyncio",
                    "way": name,
                    "drift_percent": drift * 100,
                    **quantiles(late),
                }
            )
    finally:
        if child is not None:
            child.kill()
            child.wait()
    base = next(row["median_us"] for row in rows if row["way"] == "loop.call_at")
    return [{**row, "times call_at": row["median_us"] / base if base else 0.0} for row in rows]


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    rates = [100.0] if given.quick else [10.0, 100.0, 1000.0]
    loops = [False, True] if find_spec("uvloop") is not None and not given.quick else [False]
    rows = [
        row
        for uvloop in loops
        for busy in ([False] if given.quick else [False, True])
        for rate in rates
        for row in measure(rate, 0.1 if given.quick else 2.0, busy, uvloop)
    ]
    table("Lateness of ticks", rows)
    report("ticks", {"ticks": rows}, given.output)


if __name__ == "__main__":
    main()
