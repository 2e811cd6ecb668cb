"""``mdm replay``: a recorded run once more, in virtual time, each decision compared."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.report import as_json
from mdm.config.rebuilt import rebuilt_to_compare
from mdm.recording import Record, records_of
from mdm.replay import replay, replay_together

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from mdm.replay import Replayed, Together

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Replay; return 0 where all decisions are the same, else 1."""
    given = Path(arguments.file)
    return _replay_team(given, arguments) if given.is_dir() else _replay_one(Record(given), arguments)


def _replay_one(record: Record, arguments: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory() as folder:
        run = rebuilt_to_compare(record, folder, arguments.config)
        result = replay(record, run.actors, transports=run.transports, most=_most(arguments))
    epoch = int(record.head["epoch"])
    if arguments.json:
        print(as_json(_facts(result, epoch)))
    else:
        print(_summary(record, result))
        for difference in result.differences:
            print(difference.describe(epoch))
    return 0 if result.same else 1


def _replay_team(folder: Path, arguments: argparse.Namespace) -> int:
    """Replay the records of a team's agents together: each receives what the replays of the others send."""
    records = records_of(folder)
    with ExitStack() as folders:
        runs = {
            name: rebuilt_to_compare(record, folders.enter_context(tempfile.TemporaryDirectory()), arguments.config)
            for name, record in records.items()
        }
        actors = {name: run.actors for name, run in runs.items()}
        transports = {name: run.transports for name, run in runs.items()}
        result = replay_together(records, actors, transports, most=_most(arguments))
    epochs = {name: int(record.head["epoch"]) for name, record in records.items()}
    if arguments.json:
        print(as_json(_facts_of_team(result, epochs)))
        return 0 if result.same else 1
    for name, each in result.agents.items():
        print(f"{name}: {_summary(records[name], each)}")
        for difference in each.differences:
            print(difference.describe(epochs[name]))
    unlike = len(result.unlike)
    print(f"{result.received:,} messages received, {unlike:,} of them not sent in the replay of their sender")
    if result.unrepeated:
        print(f"{result.unrepeated:,} more are of channels of the program's own, which a replay does not run")
    for received in result.unlike[: arguments.most or 1]:
        print(f"  {received.agent} received {received.key} of {received.owner}, which did not send it")
    return 0 if result.same else 1


def _most(arguments: argparse.Namespace) -> int:
    return arguments.most or (1 if arguments.config is None else 20)


def _facts_of_team(result: Together, epochs: Mapping[str, int]) -> dict[str, object]:
    return {
        "agents": {name: _facts(each, epochs[name]) for name, each in result.agents.items()},
        "messages": result.received,
        "messages_not_sent": len(result.unlike),
        "messages_unrepeated": result.unrepeated,
    }


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
