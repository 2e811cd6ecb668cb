"""How long a program waits: the import, and from the start of the process to the first decision."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

from measurement import arguments, report, table

FIRST = """
import mdm
robot = mdm.Ensemble(
    "robot", policy=mdm.policies.DeterministicPolicy([0]), actions={"A": lambda: print("decided", flush=True)}
)
async def main():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(robot)
        robot.publish_state(0)
mdm.run(main)
"""
PROGRAMS = {
    "python alone": "pass",
    "import asyncio": "import asyncio",
    "import numpy": "import numpy",
    "import numpy, scipy.sparse": "import numpy, scipy.sparse",
    "import mdm": "import mdm",
    "mdm: first decision": FIRST,
    "mdm --help": "import sys; sys.argv = ['mdm', '--help']; from mdm.cli import main; main()",
}


def main() -> None:
    """Measure in rounds, so that the machine's moods hit all alike; print and write."""
    given = arguments(__doc__ or "")
    seconds: dict[str, list[float]] = {name: [] for name in PROGRAMS}
    for turn in range(1 if given.quick else 11):
        for name, program in PROGRAMS.items():
            began = time.perf_counter()
            subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
            if turn or given.quick:  # the first warms the disk's cache
                seconds[name].append(time.perf_counter() - began)
    base = statistics.median(seconds["import numpy, scipy.sparse"])
    rows = [
        {
            "program": name,
            "median_ms": statistics.median(found) * 1e3,
            "least_ms": min(found) * 1e3,
            "times numpy and scipy": statistics.median(found) / base,
        }
        for name, found in seconds.items()
    ]
    table("From the start of a process to its end", rows)
    report("startup", {"startup": rows}, given.output)


if __name__ == "__main__":
    main()
