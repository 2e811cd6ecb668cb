"""Runs many scenarios over two processes: ``python -m chaos COUNT [FIRST]``; what is wrong is printed with its seed."""

from __future__ import annotations

import multiprocessing
import sys

from chaos.scenario import violations

SHOWN = 10
"""Seeds with violations that are printed."""


def main(count, first=0):
    """Run the scenarios of so many seeds, and return the exit status."""
    found = 0
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        results = pool.imap_unordered(violations, range(first, first + count), chunksize=50)
        for done, (seed, wrong) in enumerate(results, 1):
            if wrong:
                found += 1
                if found <= SHOWN:
                    print(f"seed {seed}:", *wrong, sep="\n  ", flush=True)
            if done % 5000 == 0 or done == count:
                print(f"{done:,} of {count:,} scenarios, {found:,} with violations", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
