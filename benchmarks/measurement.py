"""What all benchmarks share: quantiles, tables, results as JSON with the facts of the machine."""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import socket
import statistics
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

__all__ = ["arguments", "free_port", "memory_now", "memory_peak", "parser", "quantiles", "report", "table"]

RESULTS = Path(__file__).parent / "results"


def free_port() -> int:
    """Return a port of loopback that nobody listens on, below those that the system gives to whoever connects."""
    while True:
        port = random.SystemRandom().randrange(10_000, 32_000)
        with socket.socket() as one, suppress(OSError):
            one.bind(("127.0.0.1", port))
            return port


def memory_now() -> int:
    """Return the bytes that this process holds, and begin to watch for its peak."""
    Path("/proc/self/clear_refs").write_text("5")
    return _memory("VmRSS")


def memory_peak() -> int:
    """Return the most bytes that this process has held since then."""
    return _memory("VmHWM")


def _memory(key: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(key))


def parser(description: str) -> argparse.ArgumentParser:
    """Return a parser of the arguments that every benchmark takes."""
    result = argparse.ArgumentParser(description=description)
    result.add_argument("--quick", action="store_true", help="a tiny run, to see that it works")
    result.add_argument("--output", type=Path, help="where to write the JSON (benchmarks/results/NAME.json)")
    return result


def arguments(description: str) -> argparse.Namespace:
    """Read the arguments that every benchmark takes."""
    return parser(description).parse_args()


def quantiles(seconds: list[float]) -> dict[str, float]:
    """Return median and 99th percentile in microseconds."""
    ordered = sorted(seconds)
    return {
        "median_us": statistics.median(ordered) * 1e6,
        "p99_us": ordered[min(len(ordered) - 1, int(len(ordered) * 0.99))] * 1e6,
        "count": len(ordered),
    }


def table(title: str, rows: list[dict[str, Any]]) -> None:
    """Print rows with the same keys as a table."""
    print(f"\n{title}\n")
    keys = list(dict.fromkeys(key for row in rows for key in row))
    texts = [[_text(row.get(key, "")) for key in keys] for row in rows]
    widths = [max(len(key), *(len(line[i]) for line in texts)) for i, key in enumerate(keys)]
    print("  ".join(key.ljust(width) for key, width in zip(keys, widths, strict=True)))
    for line in texts:
        print("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)))


def _text(value: Any) -> str:
    return f"{value:,.2f}" if isinstance(value, float) else str(value)


def report(name: str, results: dict[str, Any], output: Path | None) -> None:
    """Write results as JSON, with the machine and the versions they were measured with."""
    path = RESULTS / f"{name}.json" if output is None else output
    path.parent.mkdir(parents=True, exist_ok=True)
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    packages = ("numpy", "scipy", "numba", "anyio", "msgspec", "pykka", "quantecon", "uvloop")
    machine |= {package: _version(package) for package in packages}
    path.write_text(json.dumps({"benchmark": name, "machine": machine, **results}, indent=1) + "\n")
    print(f"\nwritten to {path}")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
