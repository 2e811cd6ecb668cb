"""How many times sooner simulated episodes end on two processes, and what one costs beside none.

The same episodes with the same seed, by `mdm.evaluate` in batches and one at a time, and by `mdm.simulate`, in this
process, on one and on two of `mdm.simulation.Processes`, which have started before. All returns are the same. Each way
takes its turn in each of some rounds; the median counts. On two idle cores two are to be 1.8 times as fast.
"""

from __future__ import annotations

import statistics
import warnings
from typing import Any

import numpy as np
from measurement import arguments, report, table

import mdm
from mdm.simulation import Processes


def measure(*, quick: bool) -> list[dict[str, Any]]:
    """Return a row for each kind of simulation and number of workers."""
    model = mdm.problems.tiger()
    policy = mdm.policies.AlphaVectors([[9, 9], [-90, 11], [11, -90]], [0, 1, 2])
    share = 100 if quick else 1
    search = mdm.solvers.TreeSearch(model, expansions=10, seed=1, memory=2_000_000)
    ways: dict[str, Any] = {
        "batches": lambda workers: mdm.evaluate(model, policy, episodes=200_000 // share, seed=1, executor=workers),
        "one by one": lambda workers: mdm.evaluate(
            model, search, episodes=1_000 // share, steps=20, seed=1, executor=workers
        ),
        "decision loop": lambda workers: mdm.simulate(model, policy, episodes=2_000 // share, seed=1, executor=workers),
    }
    seconds: dict[tuple[str, int], list[float]] = {}
    with Processes(1) as one, Processes(2) as two:
        for place in range(2 if quick else 4):
            for name, run in ways.items():
                digests = set()
                for count, workers in enumerate((None, one, two)):
                    result = run(workers)
                    digests.add(result.returns.tobytes())
                    if place:  # the first round starts them
                        seconds.setdefault((name, count), []).append(result.seconds)
                assert len(digests) == 1
    medians = {key: statistics.median(each) for key, each in seconds.items()}
    return [
        {"episodes": name, "workers": count, "seconds": its, "times here": medians[name, 0] / its}
        for (name, count), its in medians.items()
    ]


def main() -> None:
    """Measure, show and write."""
    given = arguments(str(__doc__).splitlines()[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mdm.WorkerWarning)
        rows = measure(quick=given.quick)
    assert np.isfinite([row["seconds"] for row in rows]).all()
    table("Simulated episodes on workers", rows)
    report("workers", {"workers": rows}, given.output)


if __name__ == "__main__":
    main()
