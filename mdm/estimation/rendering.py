"""Rendering: the report about a model as text for people, and as plain data for JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.estimation.report import Report, RowReport

__all__ = ["as_data", "as_text"]

_SHOWN = 20
_ODDS = 20
"""The odds from which on a model differs: of models that are right, one in so many."""
_NAMED = 3
"""Impossible symbols that a row names, of many."""


def as_data(report: Report) -> dict[str, Any]:
    """Return a report as plain data for JSON, without the new model and the durations; no number is not finite."""
    fields = {name: getattr(report, name) for name in report.__struct_fields__ if name not in {"model", "durations"}}
    result: dict[str, Any] = _finite(msgspec.to_builtins(fields))
    return result


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_text(report: Report) -> str:
    """Return a report as lines for people: at most 20 rows of each kind, all of which `as_data` has."""
    lines = [*_head(report), *_rows_text(report), *_rates_text(report), *_frequencies_text(report)]
    lines += _ends_text(report)
    lines += [f"note: {note}" for note in report.notes]
    return "\n".join(lines)


def _head(report: Report) -> list[str]:
    states = "hidden states" if report.hidden else "known states"
    size = f"{counted(report.decisions, 'decision')} in {counted(report.chains, 'chain')}"
    lines = [f"{report.ensemble}: {size}, {report.kind}, {states}"]
    factors = [factor.name for factor in report.model.state_space.factors]
    if len(factors) > 1:
        lines.append(f"a state is {', '.join(factors)}")
    if report.discarded:
        lines.append(f"{counted(report.discarded, 'decision')} left out: neither state nor observation is known")
    if report.returns:
        expected = f"expected by {'beliefs in ' if report.hidden else ''}the model in use"
        promised = "" if report.value is None else f"; the model promises {report.value:.4g}"
        episodes = f"returns of {counted(len(report.returns), 'episode')}"
        lines.append(f"{episodes}, {expected}: {_mean(report.returns)}{promised}")
        if report.paid:
            lines.append(f"{episodes}, as the simulated world has paid: {_mean(report.paid)}")
    if report.fit is not None:
        lines.append(
            f"log likelihood {report.fit.before:.2f} by the model, {report.fit.after:.2f} by the estimate "
            f"({counted(report.fit.rounds, 'round')})"
        )
        ruled = "it differs" if report.fit.log_odds >= math.log(_ODDS) else "it agrees"
        lines.append(f"T and O together: the odds against the model are {_odds(report.fit.log_odds)}: {ruled}")
        for group in report.fit.alike[:_NAMED]:
            more = f" and {len(group) - _NAMED} more" if len(group) > _NAMED else ""
            lines.append(
                f"these states cannot be told apart by the model in this record: {', '.join(group[:_NAMED])}{more}; "
                f"which of them is which is not estimated"
            )
    kinds = ("differs", "agrees", "certain", "too few", *(["unclear"] if report.count("unclear") else []))
    lines.append(
        f"rows: {', '.join(f'{report.count(says)} {says}' for says in kinds)}; {len(report.unvisited)} not visited"
    )
    return lines


def _mean(returns: Sequence[float]) -> str:
    values = np.asarray(returns)
    spread = f" ± {values.std(ddof=1) / math.sqrt(len(values)):.4g} (standard error)" if len(values) > 1 else ""
    return f"{values.mean():.4g}{spread}"


def _rows_text(report: Report) -> list[str]:
    lines = []
    impossible = [(row, symbol, count) for row in report.rows for symbol, count in row.impossible]
    for row, symbol, count in impossible[:_SHOWN]:
        lines.append(f"impossible by the model: {row.state} -{row.action}-> {symbol}, {count} times")
    for action, symbol, count in report.impossible[:_SHOWN]:
        lines.append(f"impossible by the model: {symbol} after {action}, {count} times")
    shown = [row for row in report.rows if row.says in {"differs", "unclear"} and row.entries][:_SHOWN]
    if not shown:
        return lines
    title = "rows that differ, or are unclear" if report.count("unclear") else "rows that differ"
    lines += ["", f"{title:40}" + f"visits    model  estimate  {report.level:.0%} interval"]
    for row in shown:
        lines.append(f"{row.matrix} {row.action} {row.state}: {_why(row)}")
        lines += [
            f"  {entry.symbol:36}{entry.count:8.6g} {entry.model or 0:8.4f}  {entry.estimate:8.4f}  "
            f"{entry.low:.4f} to {entry.high:.4f}"
            for entry in row.entries
        ]
    return lines


def _why(row: RowReport) -> str:
    """Return why a row differs from the model, and what that costs."""
    parts = []
    if row.impossible:
        symbols = ", ".join(symbol for symbol, _ in row.impossible[:_NAMED])
        more = len(row.impossible) - _NAMED
        parts.append(f"{symbols}{f' and {more} more' if more > 0 else ''} followed, impossible by the model")
    parts += ["unclear"] if row.says == "unclear" else []
    parts += [] if row.p_value is None else [f"p {row.p_value:.2g}"]
    parts += [f"odds {_odds(row.log_odds)}"] if math.isfinite(row.log_odds) else []
    parts += [] if row.loss is None else [f"loss {row.loss:.4g}"]
    if (
        row.says == "differs"
        and not row.impossible
        and all(entry.low <= (entry.model or 0) <= entry.high for entry in row.entries)
    ):
        parts.append("by all entries together, of which each alone has the model's value in its interval")
    return ", ".join(parts)


def _odds(logarithm: float) -> str:
    power = logarithm / math.log(10)
    return f"10^{power:.0f} to 1" if power >= 4 else f"{10**power:.3g} to 1"


def _rates_text(report: Report) -> list[str]:
    if not report.rates:
        return []
    lines = ["", "how long states last" + " " * 20 + "  ends   seconds  interval"]
    for each in report.rates[:_SHOWN]:
        form = "" if each.stages == 1 else f"  Erlang, {each.stages} stages"
        lines.append(
            f"{each.state + ', ' + each.action:40}{each.ends:6} {each.mean:9.4g}  "
            f"{each.low:.4g} to {each.high:.4g}{form}"
        )
    return lines


def _ends_text(report: Report) -> list[str]:
    """Return how actions have ended that have not only succeeded, or been pre-empted."""
    by_row: dict[str, dict[str, int]] = {}
    for action, state, end, count in report.ends:
        by_row.setdefault(f"{state}, {action}" if state else action, {})[end] = count
    told = {row: ends for row, ends in by_row.items() if ends.keys() - {"succeeded", "preempted"}}
    lines = ["", "actions that failed or were cut short"] if told else []
    for row, ends in [*told.items()][:_SHOWN]:
        lines.append(f"{row}: {', '.join(f'{count} {end}' for end, count in ends.items())}")
    return lines


def _frequencies_text(report: Report) -> list[str]:
    if not report.frequencies:
        return []
    lines = ["", "observations" + " " * 28 + "  times  expected"]
    for each in report.frequencies[:_SHOWN]:
        lines += [
            f"{each.action + ', ' + name:40}{count:7.6g} {expected:9.6g}" for name, count, expected in each.observations
        ]
    return lines
