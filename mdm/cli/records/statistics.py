"""``mdm statistics``: their model, by the decisions of records."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.policies.inputs import load
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError
from mdm.config.rebuilt import rebuilt
from mdm.errors import Error, FormatError, ModelError
from mdm.estimation import as_data, as_text, chains_of_records, check_names, open_records, statistics
from mdm.formats import save_durations, save_model
from mdm.formats.target import check_place
from mdm.loading import revealed

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from mdm.estimation import Chains, Report
    from mdm.models import MDP
    from mdm.recording import Record


def run(arguments: argparse.Namespace) -> int:
    """Count, print and write; return the exit status."""
    _check_targets(arguments.output, arguments.durations)
    records = open_records(arguments.files)
    inputs = [*filter(None, [arguments.model]), *(path for record in records for path in record.paths)]
    for target in filter(None, (arguments.output, arguments.durations)):
        check_place(target, *inputs)
    given = _given(arguments, records[0])
    chains = chains_of_records(records, arguments.ensemble, given)
    model = _model(arguments, given, records, chains)
    report = statistics(chains, model, step=arguments.step, level=arguments.level, seed=arguments.seed or 0)
    if arguments.durations is not None and report.durations is None:
        why = "no action was seen to take time"
        if any(decision.cause == "tick" for chain in chains.chains for decision in chain.decisions):
            why = f"{chains.ensemble!r} decides at a fixed rate, so that each action takes the time between two ticks"
        raise Error(f"{arguments.durations}: there are no durations to write: {why}")
    if arguments.durations is not None and report.durations is not None:
        report.durations.interest(report.model)  # they are of use together, or refused
    if arguments.output is not None:
        save_model(report.model, arguments.output)
    if arguments.durations is not None and report.durations is not None:
        save_durations(report.durations, arguments.durations)
    if arguments.json:
        print(as_json(_facts(arguments, records, report)))
    else:
        _print(arguments, records, report)
    return 0


def _given(arguments: argparse.Namespace, record: Record) -> MDP:
    """Return the model that is named, or else that of the record."""
    if arguments.model is not None:
        return load(arguments.model, arguments.discount, arguments.discount_of)
    with tempfile.TemporaryDirectory() as folder:
        models = {path: each.controller.model for path, each in rebuilt(record, folder).ensembles.items()}
    found = [model for path, model in models.items() if f"/{path}".endswith(f"/{arguments.ensemble or path}") and model]
    if len(found) != 1:
        text = (
            f"{len(found)} models in the record are meant, of ensembles {', '.join(models)}: give --ensemble or --model"
        )
        raise Error(f"{record.path}: {text}")
    discount = found[0].discount if arguments.discount is None else arguments.discount
    return found[0].with_discount(discount, of=arguments.discount_of)


def _check_targets(output: str | None, durations: str | None) -> None:
    """Check that durations are written to an archive, and to another file than the model."""
    if durations is None:
        return
    if Path(durations).suffix.lower() != ".npz":
        raise UsageError("--durations writes an archive: its file ends in .npz")
    if output is not None and Path(output).resolve() == Path(durations).resolve():
        raise UsageError("--durations and -o are the same file")


def _model(arguments: argparse.Namespace, given: MDP, records: Sequence[Record], chains: Chains) -> MDP:
    """Return the model as the ensemble had it: with the state factors that it sees as observations, or without."""
    seen = revealed(given)
    if seen is not given and chains.hidden:
        with suppress(ModelError):
            check_names(records, chains.ensemble, seen)
            return seen
    try:
        check_names(records, chains.ensemble, given)
    except ModelError as error:
        raise FormatError(str(error), file=arguments.model or records[0].path) from None
    return given


def _facts(arguments: argparse.Namespace, records: Sequence[Record], report: Report) -> dict[str, Any]:
    return {
        "files": [str(path) for record in records for path in record.paths],
        "torn": [record.torn for record in records if record.torn is not None],
        "damage": [sentence for record in records for sentence in record.damage],
        "lost": sum(record.lost for record in records),
        "model": arguments.model,
        **as_data(report),
        "new_model": arguments.output,
        "durations": arguments.durations,
    }


def _print(arguments: argparse.Namespace, records: Sequence[Record], report: Report) -> None:
    print(as_text(report))
    for record in records:
        for sentence in record.flaws:
            print(sentence)
        if record.lost:
            print(f"{record.path}: nothing is counted across a lost decision")
    if arguments.output is not None:
        kept = (
            ""
            if Path(arguments.output).suffix.lower() == ".npz"
            else "; how often rows were seen is kept in .npz alone"
        )
        print(f"{arguments.output}: the re-estimated model{kept}")
    if arguments.durations is not None:
        print(f"{arguments.durations}: how long actions take, for --durations of mdm solve and mdm evaluate")
