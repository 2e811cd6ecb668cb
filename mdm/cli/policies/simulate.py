"""``mdm simulate``: the mean discounted return of a policy in its model."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from mdm.cli.policies.inputs import executor_of, of_run, visibility
from mdm.cli.progress import counting
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError, take_model
from mdm.config.recorded import Simulated, attach_configuration, attach_file
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
