"""Runs many scenarios over two processes: ``python -m chaos COUNT [PROCESSES [FIRST]]``.

So many scenarios in virtual time, and of teams one for each 50 of them; then so many of robots as real processes. What
is wrong is printed with its seed.
"""

from __future__ import annotations

import multiprocessing
import sys

from chaos import processes, scenario, squads

TEAMS = 50
"""Scenarios for each one of a team, which takes some ten times as long."""

SHOWN = 10
"""Seeds with violations that are printed."""


def main(count, robots=0, first=0):
    """Run the scenarios of so many seeds, and return the exit status."""
    found = _hold(scenario.violations, count, first, "scenarios", 50, 5000)
    found += _hold(squads.violations, count // TEAMS, first // TEAMS, "scenarios of teams", 5, 200)
    found += _hold(processes.violations, robots, first, "scenarios of processes", 1, 100)
    return 1 if found else 0


def _hold(violations, count, first, what, chunk, often):
    found = 0
    with multiprocessing.get_context("spawn").Pool(2, processes.hear) as pool:
        results = pool.imap_unordered(violations, range(first, first + count), chunksize=chunk)
        for done, (seed, wrong) in enumerate(results, 1):
            if wrong:
                found += 1
                if found <= SHOWN:
                    print(f"seed {seed}:", *wrong, sep="\n  ", flush=True)
            if done % often == 0 or done == count:
                print(f"{done:,} of {count:,} {what}, {found:,} with violations", flush=True)
    return found


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
