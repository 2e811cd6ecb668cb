"""``mdm replay``: a recorded run once more, in virtual time, each decision compared."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.records.rebuilt import rebuilt
from mdm.cli.report import as_json
from mdm.config.recorded import check_digests
from mdm.errors import Error
from mdm.recording import Record
from mdm.replay import Exchange, replay
from mdm.replay.replay import check_beginning

if TYPE_CHECKING:
    import argparse

    from mdm.replay import Replayed
    from mdm.replay.transport import ReplayTransport

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Replay; return 0 where all decisions are the same, else 1."""
    given = Path(arguments.file)
    return _replay_team(given, arguments) if given.is_dir() else _replay_one(Record(given), arguments)


def _replay_one(record: Record, arguments: argparse.Namespace) -> int:
    result, _ = _replayed(record, arguments)
    epoch = int(record.head["epoch"])
    if arguments.json:
        print(as_json(_facts(result, epoch)))
    else:
        print(_summary(record, result))
        for difference in result.differences:
            print(difference.describe(epoch))
    return 0 if result.same else 1


def _replay_team(folder: Path, arguments: argparse.Namespace) -> int:
    """Replay the records of a team's agents, and compare what they received with what the others' replays sent."""
    files = sorted(folder.glob("*.mcap"))
    if not files:
        raise Error(f"{folder}: there are no records in this folder: mdm team up --record {folder} makes them")
    exchange, same, facts = Exchange(), True, {}
    for file in files:
        record = Record(file)
        result, transports = _replayed(record, arguments)
        exchange.add(record, transports)
        same = same and result.same
        epoch = int(record.head["epoch"])
        facts[file.name] = _facts(result, epoch)
        if not arguments.json:
            print(f"{file.name}: {_summary(record, result)}")
            for difference in result.differences:
                print(difference.describe(epoch))
    unlike = exchange.unlike()
    if arguments.json:
        print(
            as_json(
                {
                    "agents": facts,
                    "messages": exchange.compared,
                    "messages_not_sent": len(unlike),
                    "messages_unrepeated": exchange.unrepeated,
                }
            )
        )
    else:
        print(
            f"{exchange.compared:,} messages received, {len(unlike):,} of them not sent in the replay of their sender"
        )
        if exchange.unrepeated:
            print(f"{exchange.unrepeated:,} more are of channels of the program's own, which a replay does not run")
        for received in unlike[: arguments.most or 1]:
            print(f"  {received.agent} received {received.key} of {received.owner}, which did not send it")
    return 0 if same and not unlike else 1


def _replayed(record: Record, arguments: argparse.Namespace) -> tuple[Replayed, dict[str, ReplayTransport]]:
    """Return what became of the replay of a record, and what its agents of a team sent by."""
    check_beginning(record)  # first: of one that was torn early, its files may be missing as well
    with tempfile.TemporaryDirectory() as folder:
        run = rebuilt(record, folder, arguments.config)
        if arguments.config is None:
            check_digests(record, run.ensembles.values())
        most = arguments.most or (1 if arguments.config is None else 20)
        return replay(record, run.actors, transports=run.transports, most=most), run.transports


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
