"""Sensor to callback, in turn with the commits that ``gate.toml`` names: ends with 1 where this tree is slower.

Three processes take turns, block by block, on one processor: the pinned commit, the pinned commit again, and this tree.
A row fails where the median of its pairs is beyond 3 % and beyond twice what the pinned commit differs from itself, by
the median of several launches.
"""

from __future__ import annotations

import io
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from measurement import arguments, report, table

if TYPE_CHECKING:
    from typing import Self

HERE = Path(__file__).parent
ROOT = HERE.parent
ALLOWED = 0.03


class Side:
    """A process that measures blocks of one case with one tree's ``mdm``."""

    def __init__(self, tree: Path, case: str, processor: int, *, quick: bool) -> None:
        """Start it."""
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "gate_case.py"), case, *(["--quick"] if quick else [])],
            env={**os.environ, "PYTHONPATH": str(tree)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(self._process.pid, {processor})

    def __enter__(self) -> Self:
        """Wait until it is ready."""
        self._answer()
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self._process.communicate()

    def measure(self) -> float:
        """Return what a decision costs in its next block, in microseconds."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._answer())

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"gate: a side ended with {self._process.wait()}; what it said stands above")
        return line.strip()


def tree_of(commit: str, folder: Path) -> Path:
    """Unpack a commit's packages below a folder."""
    packing = subprocess.run(["git", "archive", commit, "mdm"], cwd=ROOT, capture_output=True, check=False)
    if packing.returncode:
        raise SystemExit(f"gate: commit {commit} is not in this clone; a whole one has it: git fetch --unshallow")
    tree = folder / commit
    with tarfile.open(fileobj=io.BytesIO(packing.stdout)) as packed:
        packed.extractall(tree, filter="data")
    return tree


def compare(
    case: str, pinned: Path, processor: int, rounds: int, *, quick: bool
) -> tuple[list[float], list[float], list[float]]:
    """Return the costs of the pinned tree, of the same again, and of this one, from blocks in turn."""
    with ExitStack() as sides:
        trees = (pinned, pinned, ROOT)
        three = [sides.enter_context(Side(tree, case, processor, quick=quick)) for tree in trees]
        costs: list[list[float]] = [[], [], []]
        for turn in range(rounds):
            for place in (turn % 3, (turn + 1) % 3, (turn + 2) % 3):
                costs[place].append(three[place].measure())
        first, again, ours = costs
        return first, again, ours


def ratio(costs: list[float], to: list[float]) -> float:
    """Return the median of the ratios of pairs."""
    return statistics.median(ours / theirs for ours, theirs in zip(costs, to, strict=True))


def main() -> int:
    """Measure each case, and return the exit status."""
    given = arguments(__doc__ or "")
    launches, rounds = (1, 2) if given.quick else (9, 5)  # processes differ by more than rounds of one do
    processor = max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0
    pins = tomllib.loads((HERE / "gate.toml").read_text())["row"]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        trees = {pin["commit"]: tree_of(pin["commit"], Path(folder)) for pin in pins}
        for pin, case in chain.from_iterable([(pin, case) for case in pin["cases"]] for pin in pins):
            pinned = trees[pin["commit"]]
            runs = [compare(case, pinned, processor, rounds, quick=given.quick) for _ in range(launches)]
            spread = statistics.median(abs(ratio(again, first) - 1) for first, again, _ in runs)
            found = statistics.median(ratio(ours, first) for first, _, ours in runs)
            rows.append(
                {
                    "case": case,
                    "commit": pin["commit"],
                    "its us": statistics.median(chain.from_iterable(first for first, _, _ in runs)),
                    "ours us": statistics.median(chain.from_iterable(ours for _, _, ours in runs)),
                    "times": found,
                    "spread": spread,
                    "verdict": "slower" if found - 1 > max(ALLOWED, 2 * spread) else "holds",
                }
            )
    table("Sensor to callback, in turn with the pinned commits", rows)
    report("gate", {"rows": rows}, given.output)
    return int(any(row["verdict"] == "slower" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
