"""``mdm latency``: how long decisions take on this machine, with this system."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

from mdm.cli.report import as_json, columns
from mdm.cli.usage import UsageError, take_model
from mdm.latency.measure import measure
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.latency import Report, Row

_BARS = "▁▂▃▄▅▆▇█"


def run(arguments: argparse.Namespace) -> int:
    """Measure, and print the rows; return the exit status."""
    take_model(arguments)
    given, pair = arguments.file, (arguments.model, arguments.policy)
    if given is None:
        if None in pair:
            raise UsageError("give a TOML file, or a model and its policy")
        if arguments.agent or arguments.with_actions:
            raise UsageError("--agent and --with-actions are for a TOML file")
        given = pair
    elif any(pair) or not given.endswith(".toml"):
        raise UsageError(f"give a TOML file, or a model together with its policy, in place of {given}")
    if arguments.with_actions:
        text = f"the actions of {given} are called, many times a second, for {arguments.seconds:g} s; its tasks are not"
        print(f"mdm latency: {text}", file=sys.stderr)
    report = measure(
        given,
        seconds=arguments.seconds,
        burn=arguments.burn,
        agent=arguments.agent,
        with_actions=arguments.with_actions,
        seed=arguments.seed,
    )
    print(as_json(report) if arguments.json else "\n".join(_lines(report)))
    return 0


def _lines(report: Report) -> Iterator[str]:
    rows: list[tuple[str, ...]] = [
        ("from the stimulus to the action's call", "p50", "p99", "worst", "count", "undecided", "histogram")
    ]
    rows += [_cells(row) for row in report.rows]
    yield from columns(rows, right=range(1, 6))
    for kind, count in report.faults.items():
        yield f"meanwhile: {counted(count, 'fault')} of the kind {kind}"
    yield from (f"faster: {each}" for each in report.faster)


def _cells(row: Row) -> tuple[str, ...]:
    if row.needs:
        return row.name, "", "", "", "", "", f"not measured: needs {row.needs}: pip install {row.needs}"
    if row.p50 is None or row.p99 is None or row.worst is None:
        return row.name, "", "", "", "0", str(row.undecided), "no action was called"
    times = [_time(each) for each in (row.p50, row.p99, row.worst)]
    return (row.name, *times, str(row.count), str(row.undecided), _histogram(row))


def _time(seconds: float) -> str:
    unit, size = next(each for each in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)) if seconds >= each[1] or each[1] < 1e-5)
    return f"{seconds / size:.3g} {unit}"


def _histogram(row: Row) -> str:
    """Return a bar for each doubling of time from the shortest to the longest, behind the shortest's bound."""
    counts, bound = dict(row.histogram), row.histogram[0][0]
    most, bars = max(counts.values()), ""
    for doubled in range(round(math.log2(row.histogram[-1][0] / bound)) + 1):
        count = counts.get(bound * 2**doubled, 0)
        bars += _BARS[min(7, count * 8 // (most + 1))] if count else " "
    return f"{_time(bound)} {bars}"
