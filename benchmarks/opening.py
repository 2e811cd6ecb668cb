"""How long a record takes to show its first picture, and any other: by its summary, against all of it read.

Both in processor seconds of one process, in turn; ratios are of the medians. The record is of a robot that decides ten
times a second, made in virtual time.
"""

from __future__ import annotations

import asyncio
import random
import statistics
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from decision_latency import Callback, robot
from measurement import arguments, report, table

from mdm.recording import Record, Recorder
from mdm.snapshots import RecordedRun
from mdm.snapshots.summary import decoded
from mdm.testing import run_virtual

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm import Runtime

now = time.process_time


def record(path: Path, seconds: float) -> None:
    """Record a run of so many seconds."""

    async def main(runtime: Runtime) -> None:
        ensemble, sensor = robot("robot", Callback())
        await runtime.start(ensemble)
        for index in range(round(10 * seconds)):
            sensor.set(index % 2 == 0)
            await asyncio.sleep(0.1)

    run_virtual(main, record=Recorder(path))


def shown(opened: Callable[[], RecordedRun]) -> tuple[float, float]:
    """Return how long the first picture takes, with lanes of the whole run, and the slowest of 50 others."""
    began = now()
    run = opened()
    paths = [each.path for each in run.scene().ensembles]
    run.frame(0.0, paths)
    run.lanes(run.first, run.last, paths, [], 1_200)
    first, others, chance = now() - began, [], random.Random(0)
    for _ in range(50):
        began = now()
        run.frame(chance.uniform(run.first, run.last), paths)
        others.append(now() - began)
    return first, max(others)


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    seconds, rounds = (60.0, 1) if given.quick else (14_400.0, 5)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        record(path, seconds)
        data = RecordedRun(Record(path)).summary().encoded()
        cases: dict[str, Callable[[], RecordedRun]] = {
            "all read": lambda: RecordedRun(Record(path)),
            "by its summary": lambda: RecordedRun(Record(path), summary=decoded(data)),
        }
        found: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
        for _ in range(rounds):
            for name, opened in cases.items():
                found[name].append(shown(opened))
        size = path.stat().st_size
    base = statistics.median(first for first, _ in found["all read"])
    rows: list[dict[str, Any]] = [
        {
            "case": name,
            "first_ms": 1e3 * statistics.median(first for first, _ in each),
            "any_ms": 1e3 * max(other for _, other in each),
            "times all read": statistics.median(first for first, _ in each) / base,
        }
        for name, each in found.items()
    ]
    table(f"A record of {seconds / 3600:g} h, {size / 1e6:.1f} MB, its summary {len(data) / 1e6:.1f} MB", rows)
    report("opening", {"opening": rows}, given.output)


if __name__ == "__main__":
    main()
