"""SARSOP's bounds over time, beside those of the C++ program of its authors where that is at hand.

Both get the same seconds of one processor on the same problem, one after the other; ours is timed after its kernels are
compiled, and with one thread of the BLAS library, so that no time is counted twice. Where
the program is not at hand (``--program``, or ``pomdpsol`` on the path), its bounds are those that were recorded on a
machine with 2 cores in November 2026: good for orders, not for ratios.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported

from measurement import parser, report, table

import mdm
from mdm.compilation import can_compile
from mdm.solvers import Limits
from mdm.solvers.sarsop import sarsop

MODELS = Path(__file__).resolve().parents[2] / "shared" / "corpus" / "models" / "sarsop"
TIGER = Path(__file__).resolve().parents[1] / "examples" / "tiger.pomdp"
MARKS = (1.0, 10.0, 30.0)
RECORDED: dict[str, dict[float, tuple[float, float]]] = {
    "Hallway.pomdp": {1: (0.92, 1.223), 10: (0.9715, 1.2195), 30: (0.9846, 1.2143)},
    "Hallway2.pomdp": {1: (0.21, 0.946), 10: (0.298, 0.921), 30: (0.333, 0.910)},
    "TagAvoid.pomdp": {1: (-6.43, -0.93), 10: (-6.32, -1.48), 30: (-6.24, -1.76)},
    "TagAvoid.pomdpx": {1: (-6.06, -1.52), 10: (-5.959, -2.30), 30: (-5.959, -2.59)},
    "RockSample_7_8.pomdpx": {1: (19.97, 25.7), 10: (21.03, 25.0), 30: (21.10, 24.7)},
}
_LINE = re.compile(r"^\s*([\d.]+)\s+\d+\s+\d+\s+(\S+)\s+(\S+)\s+\S+\s+\d+\s+\d+\s*$", re.MULTILINE)


def ours(path: Path, marks: list[float]) -> dict[float, tuple[float, float]]:
    """Return the bounds that ours had at some times."""
    found = sarsop(mdm.load_model(path), limits=Limits(gap=0.0, time=marks[-1], clock=time.process_time))
    return _at(marks, [(p.seconds, p.lower, p.upper) for p in found.history])


def theirs(program: str, path: Path, marks: list[float]) -> dict[float, tuple[float, float]]:
    """Return the bounds that the C++ program had at some times."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [program, "--timeout", str(marks[-1]), "--precision", "1e-9", "-o", f"{folder}/out", str(path)],
            capture_output=True,
            text=True,
            check=False,
            timeout=20 * marks[-1] + 120,
        )
    rows = [tuple(map(float, match.groups())) for match in _LINE.finditer(done.stdout)]
    return _at(marks, rows)


def _at(marks: list[float], rows: list[Any]) -> dict[float, tuple[float, float]]:
    result = {}
    for mark in marks:
        before = [row for row in rows if row[0] <= mark * 1.02 + 0.1]
        if before:
            result[mark] = before[-1][1:]
    return result


def to_gap(path: Path, gap: float) -> float:
    """Return the seconds to a gap."""
    return mdm.solve(mdm.load_model(path).with_discount(0.95), "sarsop", gap=gap).seconds


def main() -> None:
    """Measure; print and write."""
    given_parser = parser(__doc__ or "")
    given_parser.add_argument("--program", default=shutil.which("pomdpsol"), help="the C++ program, pomdpsol")
    given = given_parser.parse_args()
    if not can_compile():
        print("numba is not installed (mdm[fast]): ours runs uncompiled, about a hundred times slower")
    to_gap(TIGER, 1e-3)
    tiger = sorted(to_gap(TIGER, 1e-3) for _ in range(3))[1]
    print(f"Tiger to a gap of 0.001: {tiger:.3f} s (the C++: recorded 0.01 s)")
    marks = [mark for mark in MARKS if not given.quick or mark < 1]
    rows = []
    for name, recorded in RECORDED.items():
        path = MODELS / name
        if not path.is_file() or not marks:
            continue
        bounds = ours(path, marks)
        others = recorded if given.program is None else theirs(given.program, path, marks)
        for mark in marks:
            lower, upper = bounds.get(mark, (float("nan"),) * 2)
            other_lower, other_upper = others.get(mark, (float("nan"),) * 2)
            rows.append(
                {
                    "problem": name,
                    "seconds": mark,
                    "lower": lower,
                    "upper": upper,
                    "C++ lower": other_lower,
                    "C++ upper": other_upper,
                    "tighter": "both" if lower >= other_lower and upper <= other_upper else "not both",
                }
            )
    if rows:
        table(f"Bounds over time; the C++ {'recorded' if given.program is None else 'in this run'}", rows)
    elif marks:
        print("the corpus of real models is not beside this checkout: only Tiger is solved")
    report("sarsop", {"tiger_s": tiger, "bounds": rows, "program": given.program is not None}, given.output)


if __name__ == "__main__":
    main()
