"""``mdm replay``: a recorded run once more, in virtual time, each decision compared."""

from __future__ import annotations

import tempfile
from typing import TYPE_CHECKING

from mdm.cli.report import as_json
from mdm.config.recorded import load_recorded
from mdm.errors import Error
from mdm.recording import Record
from mdm.replay import replay

if TYPE_CHECKING:
    import argparse

    from mdm.config import System
    from mdm.replay import Replayed

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Replay; return 0 where all decisions are the same, else 1."""
    record = Record(arguments.file)
    with tempfile.TemporaryDirectory() as folder:
        system = load_recorded(record, folder, arguments.config)
        if arguments.config is None:
            _check_digests(record, system)
        result = replay(record, system, most=arguments.most or (1 if arguments.config is None else 20))
    epoch = int(record.head["epoch"])
    if arguments.json:
        print(as_json(_facts(result, epoch)))
    else:
        print(_summary(record, result))
        for difference in result.differences:
            print(difference.describe(epoch))
    return 0 if result.same else 1


def _check_digests(record: Record, system: System) -> None:
    """Refuse to repeat a run with another model or policy than it had.

    Raises:
        Error: Of the first ensemble whose digest differs.
    """
    for ensemble in system.ensembles.values():
        known = record.metadata.get(f"ensemble {ensemble.path}", {}).get("configuration")
        now = ensemble.controller.configuration
        if known is not None and known != now:
            raise Error(
                f"{record.path}: model, policy or options of ensemble {ensemble.path!r} are not those of the run "
                f"(digest {now[:12]}, then {known[:12]}): mdm {record.head['mdm']} may have read them otherwise; with "
                f"--config a configuration of yours is compared"
            )


def _summary(record: Record, result: Replayed) -> str:
    how = "bit by bit" if result.exact else "numbers to 1e-9, for the environment differs"
    same = "all the same" if result.same else "not the same"
    lines = [f"{result.recorded} decisions recorded, {result.replayed} replayed: {same} ({how})"]
    if record.torn is not None:
        lines.append(f"torn: {record.torn}")
    if result.lost:
        lines.append(f"{result.lost} messages of the record are lost: behind these a replay differs")
    return "\n".join(lines)


def _facts(result: Replayed, epoch: int) -> dict[str, object]:
    return {
        "recorded": result.recorded,
        "replayed": result.replayed,
        "same": result.same,
        "exact": result.exact,
        "lost": result.lost,
        "differences": [
            {
                "decision": each.number,
                "fields": list(each.fields),
                "recorded": None if each.recorded is None else each.recorded.action_name,
                "replayed": None if each.replayed is None else each.replayed.action_name,
                "text": each.describe(epoch),
            }
            for each in result.differences
        ],
    }
