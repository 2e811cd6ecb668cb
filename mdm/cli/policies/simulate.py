"""``mdm simulate``: the mean discounted return of a policy in its model; and ``mdm sweep``: a row for each of many."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from mdm.checks import is_number, is_whole
from mdm.cli.policies.inputs import executor_of, of_run, visibility
from mdm.cli.progress import counting
from mdm.cli.records.export import check_table, write_table
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError, take_model
from mdm.config.recorded import Simulated, attach_configuration, attach_file
from mdm.config.sweep import planned, sweep as swept
from mdm.errors import Error
from mdm.formats.target import check_place
from mdm.recording import Recorder
from mdm.simulation import simulate
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse


def run(arguments: argparse.Namespace) -> int:
    """Simulate; return the exit status."""
    take_model(arguments)
    _check_usage(arguments)
    given = Simulated(**{name: getattr(arguments, name) for name in Simulated.__struct_fields__})
    options = given.options()
    if given.file is None and (sentence := visibility(options["model"], options["policy"])):
        print(f"mdm simulate: {sentence}", file=sys.stderr)
    recorder = _recorder(given, arguments.record)
    with executor_of(arguments) as executor, counting(arguments.interruption) as progress:
        result = simulate(
            **options,
            episodes=arguments.episodes,
            seed=arguments.seed,
            progress=progress,
            record=recorder,
            executor=executor,
        )
    if recorder is not None and recorder.kept_files:
        print(f"mdm simulate: recorded to {recorder.path}: {recorder.kept_files[-1]} is kept as it is", file=sys.stderr)
    interrupted = arguments.interruption.number is not None
    if arguments.json:
        fields = ("episodes", "steps", "mean", "standard_error")
        facts = {field: getattr(result, field) for field in fields}
        facts |= {"seed": arguments.seed, "interrupted": interrupted}
        if executor is not None:
            facts |= {"missing": result.missing, "run": of_run(result)}
        print(as_json(facts))
    else:
        print(
            f"mean discounted return {result.mean:.6g} ± {result.standard_error:.3g} (standard error), "
            f"{counted(result.episodes, 'episode')} of {counted(result.steps, 'decision')}"
        )
        if interrupted:
            print(f"interrupted: this is of {counted(result.episodes, 'episode')}, not of {arguments.episodes}")
        if result.missing:
            print(f"missing: {counted(result.missing, 'episode')}, of parts that failed")
    return arguments.interruption.status if interrupted else int(result.missing > 0)


def _check_usage(arguments: argparse.Namespace) -> None:
    if arguments.file is None and (arguments.model is None or arguments.policy is None):
        raise UsageError("give a TOML file, or both --model and --policy")
    if arguments.file is None and arguments.ensemble is not None:
        raise UsageError("--ensemble is for a TOML file")
    if arguments.record is not None and (arguments.workers or arguments.dask is not None):
        raise UsageError("a record is of one process: give --record without --workers and --dask")
    if arguments.file is None:
        return
    if arguments.model is not None or arguments.policy is not None:
        raise UsageError("--model and --policy stand in place of a TOML file: give either")
    if arguments.discount is not None or arguments.false_negative is not None:
        raise UsageError("--discount and --false-negative are for --model; a TOML file has its own")


def _recorder(given: Simulated, path: str | None) -> Recorder | None:
    """Return the recorder of a simulation, with the files that a replay reads; None where it is not recorded."""
    if path is None:
        return None
    recorder = Recorder(path)
    if given.file is not None:
        attach_configuration(recorder, given.file)
        kept = {"file": Path(given.file).name}
    else:
        files = {"model": given.model, "policy": given.policy}
        kept = {name: attach_file(recorder, file) for name, file in files.items() if file is not None}
    recorder.head(simulation=msgspec.json.encode(msgspec.structs.replace(given, **kept)).decode())
    return recorder


def sweep(arguments: argparse.Namespace) -> int:
    """Run the points of a sweep that have not ended; return the exit status."""
    output = Path(arguments.output)
    journal = output.with_suffix(".jsonl")
    check_table(output)
    check_place(output, arguments.file)
    if output.exists() and not (arguments.resume and journal.exists()):
        raise Error(f"{output}: this file is here already: give another, or --resume to go on with its {journal.name}")
    plan = planned(arguments.file)
    with executor_of(arguments) as executor, counting(arguments.interruption, noun="point") as progress:
        rows = swept(plan, journal, resume=arguments.resume, progress=progress, executor=executor)
    failed = [row for row in rows if row["failure"] is not None]
    interrupted = len(rows) < len(plan.points)
    facts = {"result": None, "journal": str(journal), "points": len(plan.points), "ended": len(rows) - len(failed)}
    if not interrupted and len(failed) < len(rows):
        columns = {name: [row[name] for row in rows] for name in rows[0]}
        numbers = {name: [each for each in columns[name] if each is not None] for name in columns if name != "failure"}
        real = {name for name, values in numbers.items() if all(map(is_number, values))}
        for name in columns.keys() - real:
            columns[name] = [each if isinstance(each, str | None) else as_json(each) for each in columns[name]]
        write_table(output, columns, {name for name in real if all(map(is_whole, numbers[name]))}, real)
        facts["result"] = str(output)
    if arguments.json:
        failures = [{name: row[name] for name in ("point", "failure")} for row in failed]
        print(as_json({**facts, "failures": failures, "interrupted": interrupted}))
    elif failed:
        given = ", ".join(f"{name} {value}" for name, value in plan.points[failed[0]["point"]][1].items())
        told = f"{len(failed)} of {counted(len(rows), 'point')} failed, and --resume tries them once more"
        print(f"mdm sweep: {told}; the first, {given}: {failed[0]['failure']}", file=sys.stderr)
    if interrupted and not arguments.json:
        print(f"interrupted: {journal} has {len(rows)} of {counted(len(plan.points), 'point')}, --resume goes on")
    elif facts["result"] is not None and not arguments.json:
        print(f"{output}: {counted(len(rows), 'point')} written")
    return arguments.interruption.status if interrupted else int(bool(failed))
