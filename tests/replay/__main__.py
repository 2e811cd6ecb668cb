"""Records and replays many random systems over two processes: ``python -m replay COUNT [FIRST [SECONDS [BUSY]]]``.

What is wrong is printed with its seed; BUSY more processes keep the machine busy meanwhile.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed

from replay import runs


def main(count, first=0, seconds=0.5, busy=1):
    """Record and replay the systems of so many seeds, and return the exit status."""
    folder = tempfile.mkdtemp(prefix="replay-")
    context = multiprocessing.get_context("spawn")
    spinners = [context.Process(target=runs.spin, daemon=True) for _ in range(busy)]
    for spinner in spinners:
        spinner.start()
    decisions = differ = none = 0
    jobs = [(seed, seconds, folder) for seed in range(first, first + count)]
    with ProcessPoolExecutor(2, context) as pool:
        for future in as_completed([pool.submit(runs.work, job) for job in jobs]):
            seed, made, wrong = future.result()
            decisions += made
            none += not made
            if wrong:
                differ += 1
                print(f"seed {seed}, {made} decisions:", *wrong, sep="\n  ", flush=True)
    for spinner in spinners:
        spinner.kill()
    print(
        f"{count:,} systems, {decisions:,} decisions, {differ:,} systems differ, {none:,} without decisions; {folder}"
    )
    return 1 if differ else 0


if __name__ == "__main__":
    given = sys.argv[1:]
    sys.exit(main(*map(int, given[:2]), *map(float, given[2:3]), *map(int, given[3:4])))
