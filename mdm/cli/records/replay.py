"""``mdm replay`` and ``mdm explain``: whether decisions of a record repeat themselves, and why one was made."""

from __future__ import annotations

import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from mdm.cli.report import as_json
from mdm.config.rebuilt import different_entry, different_part, rebuilt, rebuilt_to_compare, replay_team
from mdm.errors import Error, ModelError
from mdm.recording import Record, records_of
from mdm.recording.table import Names, names_of
from mdm.replay import replay
from mdm.replay.retraced import decisions_of, found, redecided, retraced
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Mapping, Sequence

    from mdm.actors import Ensemble
    from mdm.messages import Decision
    from mdm.replay import Replayed, Together

_ROWS = 20


def run(arguments: argparse.Namespace) -> int:
    """Replay; return 0 where all decisions are the same, else 1."""
    given = Path(arguments.file)
    return _replay_team(given, arguments) if given.is_dir() else _replay_one(Record(given), arguments)


def _replay_one(record: Record, arguments: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory() as folder:
        run = rebuilt_to_compare(record, folder, arguments.config)
        other = arguments.config is not None
        most = arguments.most or (20 if other else 1)
        result = replay(record, run.actors, transports=run.transports, most=most, by_time=other)
        table = _redecided(record, run.ensembles) if other else None
    entry = _different(record, run.ensembles) if other else None
    epoch = int(record.head["epoch"])
    if arguments.json:
        facts = {} if table is None else {"redecided": table}
        print(as_json(_facts(result, epoch) | facts | ({} if entry is None else {"entry": entry})))
    else:
        print(_summary(record, result))
        for difference in result.differences:
            print(difference.describe(epoch))
        for line in _lines(table or []):
            print(line)
        if entry is not None:
            print(entry)
    return 0 if result.same else 1


def _redecided(record: Record, ensembles: Mapping[str, Ensemble]) -> list[dict[str, object]]:
    """Return the decisions that differ in the same state, or on the same belief: a row for each state and action."""
    names: dict[str, Names] = names_of(record)
    rows: list[dict[str, object]] = []
    by_ensemble: dict[str, list[Decision]] = defaultdict(list)
    for decision in decisions_of(record) if record.counts["decisions"] else []:
        by_ensemble[decision.ensemble].append(decision)
    for path, decisions in by_ensemble.items():
        ensemble = ensembles.get(path)
        if ensemble is None or getattr(ensemble.controller.policy, "deliberates", False):
            continue  # it was started by a task, or searches for as long as it is let
        counts: Counter[tuple[str, str, str]] = Counter()
        visits: Counter[str] = Counter()
        try:
            for decision, step in redecided(ensemble.controller, decisions):
                known = names.get(path, Names())
                told = _where(decision, known)
                visits[told] += 1
                if step.action != decision.action:
                    counts[told, decision.action_name, ensemble.joint_name(step.action)] += 1
        except ModelError as error:
            rows.append({"ensemble": path, "problem": str(error)})
        for (state_name, then, now), count in counts.most_common():
            row = {"ensemble": path, "state": state_name, "decisions": visits[state_name], "recorded": then}
            rows.append(row | {"now": now, "count": count})
    return rows


def _where(decision: Decision, names: Names) -> str:
    """Return the state of a decision, or the most likely one."""
    if decision.belief is None or decision.state is not None:
        return names.state(decision.state) or f"state {decision.state}"
    most = int(decision.belief.argmax())
    return f"most likely {names.state(most) or f'state {most}'}"


def _lines(table: Sequence[Mapping[str, object]]) -> Iterator[str]:
    if table:
        yield "decided otherwise in the same state or on the same belief, each by itself:"
    for row in table[:_ROWS]:
        if "problem" in row:
            yield f"  {row['ensemble']} cannot decide so: {row['problem']}"
            continue
        yield (
            f"  {row['ensemble']}, {row['state']}: {row['recorded']!r}, now {row['now']!r}, in {row['count']} of "
            f"{row['decisions']} decisions"
        )
    if len(table) > _ROWS:
        yield f"  and {len(table) - _ROWS} more"


def _different(record: Record, ensembles: Mapping[str, Ensemble]) -> str | None:
    """Return in words the first difference of model, policy and options, whether decisions differ or not; else None."""
    entry = different_entry(record, ensembles)
    if entry is not None:
        return entry
    for path, ensemble in ensembles.items():
        part = different_part(record.metadata.get(f"ensemble {path}", {}), ensemble.controller)
        if part is not None:
            return f"ensemble {path!r}: {part}"
    return None


def _replay_team(folder: Path, arguments: argparse.Namespace) -> int:
    """Replay the records of a team's agents together: each receives the messages of the others' replays."""
    records = records_of(folder)
    result = replay_team(records, arguments.config, most=arguments.most or 1)
    epochs = {name: int(record.head["epoch"]) for name, record in records.items()}
    if arguments.json:
        print(as_json(_facts_of_team(result, epochs)))
        return 0 if result.same else 1
    for name, each in result.agents.items():
        print(f"{name}: {_summary(records[name], each)}")
        for difference in each.differences:
            print(difference.describe(epochs[name]))
        if each.limit is not None:
            since = _seconds(records[name], each.limit.time)
            print(f"from {since} s on nothing can be told of it, for {each.limit.reason}")
    if result.traffic is None:
        print("sensors, ends of actions, delays and losses of messages are as they were in the run")
    else:
        _print_messages(result, arguments.most or 1)
    return 0 if result.same else 1


def _print_messages(result: Together, most: int) -> None:
    """Print how many messages were sent as they were received, and which were not."""
    print(
        f"{result.received:,} messages received, {len(result.unlike):,} of them not sent in the replay of their sender"
    )
    if result.unrepeated:
        print(f"{result.unrepeated:,} more are of channels of the program's own, which a replay does not run")
    for agent, count in result.strange.items():
        print(f"{count:,} more are of {agent} in a life of which there is no record here")
    for received in result.unlike[:most]:
        print(f"  {received.agent} received {received.key} of {received.owner}, which did not send it")


def _facts_of_team(result: Together, epochs: Mapping[str, int]) -> dict[str, object]:
    agents = {name: _facts(each, epochs[name]) for name, each in result.agents.items()}
    if result.traffic is None:
        for name, each in result.agents.items():
            agents[name]["different"] = each.different
        return {"agents": agents}
    return {
        "agents": agents,
        "messages": result.received,
        "messages_not_sent": len(result.unlike),
        "messages_unrepeated": result.unrepeated,
        "messages_strange": result.strange,
    }


def _summary(record: Record, result: Replayed) -> str:
    how = "bit by bit" if result.exact else "numbers to 1e-9, for the environment differs"
    several = len(result.differences) < result.different
    same = f"{result.different} not the same" if several else "not the same" if result.different else "all the same"
    until = "" if result.limit is None else f"up to {_seconds(record, result.limit.time)} s, "
    if result.limit is not None and not result.recorded and not result.replayed:
        same = "nothing to compare"
    stopped = " before it stopped at a difference" if result.stopped else ""
    lines = [
        f"{until}{counted(result.recorded, 'decision')} recorded, {result.replayed} replayed{stopped}: {same} ({how})"
    ]
    lines += record.flaws + record.cannot
    if result.gap is not None:
        lines.append(
            f"before {_seconds(record, result.gap.until)} s messages of the record are lost: what was decided from "
            f"there on cannot be replayed, and is not compared"
        )
    return "\n".join(lines)


def _seconds(record: Record, time: int) -> str:
    return f"{(time - int(record.head['epoch'])) / 1e9:.6f}"


def _facts(result: Replayed, epoch: int) -> dict[str, object]:
    limit = result.limit
    until: dict[str, object] = {}
    if result.gap is not None:
        until = {"until": (result.gap.until - epoch) / 1e9, "reason": "messages of the record are lost before"}
    if limit is not None:
        until = {"until": (limit.time - epoch) / 1e9, "reason": limit.reason}
    return {
        **until,
        "recorded": result.recorded,
        "replayed": result.replayed,
        "stopped": result.stopped,
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


def explain(arguments: argparse.Namespace) -> int:
    """Explain a decision; return the exit status."""
    from mdm.explanation import explain as explained  # noqa: PLC0415 - a replay says nothing of why
    from mdm.snapshots.why import is_as_recorded  # noqa: PLC0415

    record = Record(arguments.file)
    place, decisions = found(record, arguments.ensemble, arguments.at)
    decision = decisions[place]
    with tempfile.TemporaryDirectory() as folder:
        ensemble = rebuilt(record, folder, arguments.config).ensembles.get(decision.ensemble)
        if ensemble is None:
            raise Error(
                f"{record.path}: the configuration has no ensemble {decision.ensemble!r}: a task has started it"
            )
        same = is_as_recorded(record, ensemble)
        other = None if same else _difference(record, ensemble, given=arguments.config is not None)
        step = retraced(ensemble.controller, decisions, place, otherwise=other is not None)
        explanation = explained(ensemble.named(step.case(arguments.last or 10)))
    start = 0 if record.span is None else record.span[0]
    second = (decision.time - start) / 1e9
    if arguments.json:
        facts: dict[str, object] = {"ensemble": decision.ensemble, "time": second, "cause": decision.cause}
        facts |= msgspec.to_builtins(explanation)
        facts |= {} if other is None else {"configuration": other, "decided": decision.action_name}
        print(as_json(facts | {"flaws": record.flaws}))
    else:
        print(f"{decision.ensemble} at {second:.6g} s, because of: {decision.cause}.")
        if other is not None:
            print(f"By another configuration, as it would decide now ({other}); decided was {decision.action_name!r}.")
        print(explanation)
        for sentence in record.flaws:
            print(sentence)
    return 0


def _difference(record: Record, ensemble: Ensemble, *, given: bool) -> str:
    """Return the difference of the model, policy or options, where they were given, to those that decided.

    Raises:
        Error: If they are the record's own, which are read otherwise now.
    """
    path, controller = ensemble.path, ensemble.controller
    facts = record.metadata.get(f"ensemble {path}", {})
    known, now = facts.get("configuration", ""), controller.configuration
    told = (different_entry(record, {path: ensemble}) if given else None) or different_part(facts, controller)
    digests = f"digest {now[:12]}, then {known[:12]}"
    if given:
        return told or digests
    raise Error(
        f"{record.path}: model, policy or options in the record, as mdm {record.head['mdm']} has read them, are not "
        f"those that decided in {path!r} ({digests if told is None else told}): what they say of its decisions would "
        f"explain nothing"
    )
