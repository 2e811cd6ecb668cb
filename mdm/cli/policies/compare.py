"""``mdm compare``: the values of several policies in one model."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import numpy as np

from mdm.cli.policies.inputs import load, load_durations_for, load_for, visibility
from mdm.cli.policies.verdict import between, judge
from mdm.cli.report import as_json
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from mdm.cli.policies.verdict import Verdict

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Compare; return the exit status."""
    if arguments.seed is None:
        arguments.seed = int(np.random.SeedSequence().generate_state(1)[0])
    model = load(arguments.model, arguments.discount, arguments.discount_of)
    durations = load_durations_for(model, arguments.durations)
    pairs = [load_for(model, path, arguments) for path in arguments.policies]
    for note in filter(None, dict.fromkeys(visibility(world, policy) for policy, world in pairs)):
        print(f"mdm compare: {note}", file=sys.stderr)
    verdicts: list[Verdict] = []
    for place, (policy, world) in enumerate(pairs, 1):
        told = f"policy {place} of {len(pairs)}  "
        verdicts.append(judge(world, policy, arguments, durations, simulated=True, what=told))
        if interrupted := arguments.interruption.number is not None:
            break
    differences = [_difference(verdict, verdicts[0]) for verdict in verdicts]
    if arguments.json:
        rows = zip(arguments.policies, verdicts, differences, strict=False)
        print(
            as_json(
                [
                    {"policy": path}
                    | verdict.facts()
                    | {"difference": difference, "difference_within": within, "interrupted": interrupted}
                    | (
                        {}
                        if (known := _by_records(verdict, verdicts[0])) is None
                        else {"difference_possible": known[1]}
                    )
                    for path, verdict, (difference, within) in rows
                ]
            )
        )
        return arguments.interruption.status if interrupted else 0
    table = [("policy", "claimed", "exact", "simulated", "", "difference", "")]
    for path, verdict, (difference, within) in zip(arguments.policies, verdicts, differences, strict=False):
        result = verdict.simulated
        assert result is not None
        half = (result.interval[1] - result.interval[0]) / 2
        exact = None if verdict.exact is None else verdict.exact[0]
        cells = (_number(verdict.claimed), _number(exact), _number(result.mean), f"± {half:.2g}")
        table.append((path, *cells, f"{difference:+.4g}", f"± {within:.2g}"))
    _print(table)
    for path, verdict in zip(arguments.policies, verdicts, strict=False):
        if (known := _by_records(verdict, verdicts[0])) is not None:
            (low, high), (less, more) = known
            beside = "" if verdict is verdicts[0] else f", difference {less:+.4g} to {more:+.4g}"
            print(f"{path} by the model's records: {low:.4g} to {high:.4g}{beside}")
    result = verdicts[0].simulated
    assert result is not None
    print(
        f"± is 95 % confidence; {counted(result.episodes, 'episode')} of at most {counted(result.steps, 'step')} each, "
        f"seed {arguments.seed}"
    )
    if interrupted:
        last = verdicts[-1].simulated
        assert last is not None
        print(
            f"interrupted: the last policy above has {counted(last.episodes, 'episode')}, and those after it are not "
            f"compared"
        )
    return arguments.interruption.status if interrupted else 0


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def _difference(verdict: Verdict, first: Verdict) -> tuple[float, float]:
    """Return the difference of a policy's value from the first's, and its 95 % margin, from paired episodes."""
    if verdict.exact is not None and first.exact is not None:
        return verdict.exact[0] - first.exact[0], 0.0
    assert verdict.simulated is not None
    assert first.simulated is not None
    ours, theirs = verdict.simulated, first.simulated
    if ours.episodes != theirs.episodes:
        return ours.mean - theirs.mean, 1.96 * math.hypot(ours.standard_error, theirs.standard_error)
    differences = ours.returns - theirs.returns
    error = float(differences.std(ddof=1)) / math.sqrt(len(differences)) if len(differences) > 1 else 0.0
    return float(differences.mean()), 1.96 * error


def _by_records(verdict: Verdict, first: Verdict) -> tuple[list[float], list[float]] | None:
    """Return between what a value, and its difference from the first, are by the records of an estimated model."""
    if verdict.possible is None or first.possible is None:
        return None
    return between(verdict.possible), between(verdict.possible - first.possible)


def _print(table: Sequence[Sequence[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        cells = [
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  ".join(cells).rstrip())
