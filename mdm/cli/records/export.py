"""``mdm record export`` and ``mdm record repair``: the decisions of a record as a table, and a torn one as a whole."""

from __future__ import annotations

import csv
import importlib
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.formats.target import check_place, replacing
from mdm.recording.reader import Record, repair as repaired
from mdm.recording.table import Names, Row, names_of, rows
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Collection, Iterator

_MOST = 5000
"""Columns of beliefs, at most."""

_WHOLE = {"time", "epoch", "state", "action", "life", "true_state"}
_REAL = {"seconds", "reward", "end_seconds", "true_reward"}
"""Columns of numbers, beside those of beliefs; the others are text."""

Columns = dict[str, list[Any]]


def run(arguments: argparse.Namespace) -> int:
    """Write the decisions as a table; return the exit status."""
    check_table(arguments.output)
    record = Record(arguments.file)
    check_place(arguments.output, *record.paths)
    if not record.counts["decisions"]:
        raise Error(f"{record.path}: there are no decisions in this record")
    found = rows(record, arguments.ensemble)
    if not found and arguments.ensemble is not None:
        there = ", ".join(sorted({row.decision.ensemble for row in rows(record)}))
        raise Error(f"{record.path}: there are no decisions of {arguments.ensemble!r}; there are of {there or 'none'}")
    columns = _columns(record, found, beliefs=not arguments.no_beliefs)
    symbols = any(isinstance(each, str) for each in columns["observation"])
    beliefs = {name for name in columns if name.startswith("belief[")}
    write_table(arguments.output, columns, _WHOLE if symbols else _WHOLE | {"observation"}, _REAL | beliefs)
    print(f"{arguments.output}: {counted(len(found), 'decision', ',')} written")
    for sentence in record.flaws:
        print(sentence)
    return 0


def _columns(record: Record, found: list[Row], *, beliefs: bool) -> Columns:
    start = 0 if record.span is None else record.span[0]
    names = names_of(record)
    decisions = [row.decision for row in found]
    observations: list[Any] = [each.observation for each in decisions]
    if not all(each is None or isinstance(each, int) for each in observations):  # some have several components
        observations = [None if each is None else json.dumps(each) for each in observations]
    columns: Columns = {
        "time": [each.time for each in decisions],
        "seconds": [(each.time - start) / 1e9 for each in decisions],
        "ensemble": [each.ensemble for each in decisions],
        "epoch": [each.epoch for each in decisions],
        "cause": [each.cause for each in decisions],
        "state": [each.state for each in decisions],
        "state_name": [row.state for row in found],
        "observation": observations,
        "observation_name": [row.observation for row in found],
        "action": [each.action for each in decisions],
        "action_name": [each.action_name for each in decisions],
        "wanted_name": [each.wanted_name for each in decisions],
        "reward": [each.reward for each in decisions],
        "life": [row.life for row in found],
        "end": [row.end for row in found],
        "end_seconds": [None if row.ended is None else (row.ended - start) / 1e9 for row in found],
        "end_detail": [row.detail or None for row in found],
        "true_state": [row.true_state for row in found],
        "true_state_name": [names.get(row.decision.ensemble, Names()).state(row.true_state) for row in found],
        "true_reward": [row.true_reward for row in found],
    }
    return columns | (dict(_beliefs(record, found, names)) if beliefs else {})


def _beliefs(record: Record, found: list[Row], names: dict[str, Names]) -> Iterator[tuple[str, list[Any]]]:
    """Yield a column for each state of each ensemble that has a belief."""
    sizes: dict[str, int] = {}
    for row in found:
        if row.decision.belief is not None:
            sizes[row.decision.ensemble] = len(row.decision.belief)
    if sum(sizes.values()) > _MOST:
        raise Error(
            f"{record.path}: beliefs have {sum(sizes.values()):,} states, and tables at most {_MOST:,} columns for "
            f"them: leave them out by --no-beliefs, or choose an ensemble by --ensemble"
        )
    for ensemble, size in sizes.items():
        own = names.get(ensemble, Names())
        for state in range(size):
            name = own.state(state) or str(state)
            label = f"belief[{name}]" if len(sizes) == 1 else f"belief[{ensemble}: {name}]"
            yield (
                label,
                [
                    None
                    if row.decision.belief is None or row.decision.ensemble != ensemble
                    else float(row.decision.belief[state])
                    for row in found
                ],
            )


def check_table(path: str | Path) -> None:
    """Refuse a file that can be no table, by its suffix or without pyarrow."""
    suffix = Path(path).suffix.lower()
    if suffix not in {".csv", ".parquet"}:
        raise UsageError(f"the file of a table ends in .csv or .parquet, not {str(path)!r}")
    if suffix == ".parquet":
        _pyarrow()


def write_table(path: str | Path, columns: Columns, whole: Collection[str], real: Collection[str]) -> None:
    """Write a table.

    Args:
        path: Its file, see `check_table`.
        columns: Its columns.
        whole: Those of whole numbers.
        real: Those of numbers; the others are text.
    """
    with replacing(path) as file:
        if Path(path).suffix.lower() == ".csv":
            text = io.TextIOWrapper(file, encoding="utf-8", newline="")
            writer = csv.writer(text)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
            text.detach()
            return
        arrow, parquet = _pyarrow()
        kinds = {name: arrow.int64() if name in whole else arrow.float64() for name in {*whole, *real}}
        arrays = {name: arrow.array(values, kinds.get(name, arrow.string())) for name, values in columns.items()}
        parquet.write_table(arrow.table(arrays), file)


def _pyarrow() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise Error("tables in parquet need pyarrow: pip install pyarrow") from None


def repair(arguments: argparse.Namespace) -> int:
    """Write the record as a complete one; return the exit status."""
    record = Record(arguments.file)
    check_place(arguments.output, *record.paths)
    with replacing(arguments.output) as file:
        count = repaired(record, file)
    print(f"{arguments.output}: {counted(count, 'message', ',')} written")
    for sentence in record.flaws:
        print(sentence)
    if record.torn is not None and record.unread:
        print(f"{record.unread:,} bytes could not be read")
    if not record.flaws:
        print(f"{arguments.file}: it was complete")
    return 0
