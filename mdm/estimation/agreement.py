"""Agreement: which rows of a model the counts contradict.

The G-test of a row compares the likelihood of its counts under the model with that under their own frequencies; twice
the logarithm of the ratio is about chi-squared with a degree of freedom for each entry but one (S. S. Wilks, 1938). It
is conservative where counts are small, as Pearson's is not. Over the rows with at least `LEAST` visits the share of
false discoveries is held by the step-up procedure of Y. Benjamini and Y. Hochberg (1995). The odds of a row are those
of an unknown distribution, Dirichlet(1/2), against the model's: a Bayes factor, and the final value of the martingale
that `mdm.estimation.drift` watches.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np

from mdm.estimation.intervals import PRIOR

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.estimation.rows import Row
    from mdm.models.matrices import Vector

__all__ = ["FALSE_DISCOVERIES", "LEAST", "Verdict", "discoveries", "g_test", "log_odds", "verdicts"]

LEAST = 5
"""The number of visits from which on a row is tested."""
FALSE_DISCOVERIES = 0.05
"""The share of rows said to differ that agree, in expectation."""


class Verdict(msgspec.Struct, frozen=True):
    """What the counts of a row say about the model.

    Attributes:
        says: ``differs``, ``agrees``, ``certain`` where the model leaves no choice, ``too few`` visits to say. Of
            hidden states also ``unclear``: the row is not refused, but an interval leaves out the model's value, or
            the record does not tell its states apart.
        p_value: Of the G-test; None where there was none.
        log_odds: The natural logarithm of the odds against the model; infinite where something impossible came.
    """

    says: Literal["differs", "agrees", "certain", "too few", "unclear"]
    p_value: float | None
    log_odds: float


def g_test(counts: Vector, model: Vector) -> float:
    """Return the p-value of the G-test of counts against probabilities, none of which is 0; 1 for a single entry.

    Example:
        >>> round(g_test(np.array([60.0, 40.0]), np.array([0.5, 0.5])), 4)
        0.0449
    """
    from scipy.special import gammaincc  # noqa: PLC0415 - slow to import

    if len(counts) < 2:
        return 1.0
    seen = counts > 0
    statistic = 2 * float((counts[seen] * np.log(counts[seen] / (counts.sum() * model[seen]))).sum())
    return float(gammaincc((len(counts) - 1) / 2, max(statistic, 0.0) / 2))


def log_odds(counts: Vector, model: Vector) -> float:
    """Return the logarithm of the odds of Dirichlet(1/2) against the probabilities of the model, after some counts."""
    from scipy.special import gammaln  # noqa: PLC0415 - slow to import

    if len(counts) < 2:
        return 0.0
    prior = np.full(len(counts), PRIOR)
    mixture = (
        gammaln(prior.sum())
        - gammaln(prior.sum() + counts.sum())
        + (gammaln(prior + counts) - math.log(math.pi) / 2).sum()
    )
    return float(mixture - (counts * np.log(model)).sum())


def discoveries(p_values: Sequence[float], rate: float = FALSE_DISCOVERIES) -> npt.NDArray[np.bool_]:
    """Return which hypotheses are refused, so that of these a share of ``rate`` is true in expectation."""
    values = np.asarray(p_values, dtype=np.float64)
    refused = np.zeros(len(values), dtype=bool)
    order = np.argsort(values, kind="stable")
    below = np.flatnonzero(values[order] <= rate * np.arange(1, len(values) + 1) / max(len(values), 1))
    if len(below):
        refused[order[: below[-1] + 1]] = True
    return refused


def verdicts(
    rows: Sequence[Row], *, rate: float = FALSE_DISCOVERIES, p_values: Sequence[float | None] | None = None
) -> tuple[Verdict, ...]:
    """Return what the counts say about each row, in the order of the rows.

    Args:
        rows: The rows.
        rate: The share of false discoveries.
        p_values: By default those of the G-test. Expected counts of hidden states need others.
    """
    tested = [
        place for place, row in enumerate(rows) if row.visits >= LEAST and len(row.symbols) > 1 and not row.impossible
    ]
    given = p_values if p_values is not None else [None] * len(rows)
    found = {}
    for place in tested:
        value = given[place]
        found[place] = g_test(rows[place].counts, rows[place].model) if value is None else value
    refused = dict(zip(tested, discoveries(list(found.values()), rate).tolist(), strict=True))
    return tuple(_verdict(row, found.get(place), refused.get(place)) for place, row in enumerate(rows))


def _verdict(row: Row, p_value: float | None, refused: bool | None) -> Verdict:
    if row.impossible:
        return Verdict("differs", None, math.inf)
    if len(row.symbols) < 2:
        return Verdict("certain", None, 0.0)
    odds = log_odds(row.counts, row.model)
    if refused is None:
        return Verdict("too few", None, odds)
    return Verdict("differs" if refused else "agrees", p_value, odds)
