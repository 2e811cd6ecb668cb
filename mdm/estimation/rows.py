"""Rows: the probabilities of the symbols after a state and an action, and whether counts agree with the model.

Only symbols that the model holds possible are estimated. One that has followed without a probability in the model is
listed apart, with its count: averaged in, it would be a small number somewhere, and it is a sensor that is wired wrong,
or a model that lacks an entry.

Intervals are equal-tailed ones of Jeffreys' posterior, whose coverage at fixed true values is close to its level on the
average over samples (L. D. Brown, T. T. Cai and A. DasGupta, *Interval estimation for a binomial proportion*,
Statistical Science 16, 2001). For a row of k probabilities the prior is Dirichlet(1/2) **on the entries that the model
has**: the same prior on all states, of which a row has a few, covers half as often as it should.

The G-test of a row compares the likelihood of its counts under the model with that under their own frequencies; twice
the logarithm of the ratio is about chi-squared with a degree of freedom for each entry but one (S. S. Wilks, 1938). It
is conservative where counts are small, as Pearson's is not. Over the rows with at least `LEAST` visits the share of
false discoveries is held by the step-up procedure of Y. Benjamini and Y. Hochberg (1995). The odds of a row are those
of an unknown distribution, Dirichlet(1/2), against the model's: a Bayes factor, and the final value of the martingale
that `mdm.estimation.drift` watches.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.checks import is_number
from mdm.errors import ModelError
from mdm.models.matrices import Matrix, is_compressed

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mdm.estimation.chains import Kind, Stay
    from mdm.models.matrices import Vector
    from mdm.models.mdp import MDP

LEVEL = 0.95
"""The probability of the intervals, by default."""
PRIOR = 0.5
"""Jeffreys' prior adds this to each count."""
LEAST = 5
"""The number of visits from which on a row is tested."""
FALSE_DISCOVERIES = 0.05
"""The share of rows said to differ that agree, in expectation."""

Counts = dict[tuple[int, int], dict[int, int]]
"""The counts of a model's rows: by action and state, then by the symbol that followed."""


class Row(msgspec.Struct, frozen=True):
    """The symbols that follow a state and an action.

    Attributes:
        action: The action.
        state: The state: of transitions the one before, of observations the one after the action.
        symbols: The k states, or observations, that the model holds possible.
        model: Their probabilities by the model, k numbers.
        counts: How often each has followed, k numbers; where states are hidden, expected counts.
        estimates: Their probabilities as estimated, k numbers.
        low: The lower ends of the intervals.
        high: The upper ends of the intervals.
        impossible: The symbols that have followed though the model says that they cannot, with their counts.
    """

    action: int
    state: int
    symbols: npt.NDArray[np.intp]
    model: npt.NDArray[np.float64]
    counts: npt.NDArray[np.float64]
    estimates: npt.NDArray[np.float64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    impossible: tuple[tuple[int, int], ...] = ()

    @property
    def visits(self) -> float:
        """How often something that the model holds possible has followed."""
        return float(self.counts.sum())


def counted(stays: Iterable[Stay]) -> Counts:
    """Return how often each state followed each state and action."""
    counts: Counts = defaultdict(lambda: defaultdict(int))
    for state, action, _, next_state, ended in stays:
        if ended and state is not None and next_state is not None:
            counts[action, state][next_state] += 1
    return {key: dict(row) for key, row in counts.items()}


def support(matrix: Matrix, row: int) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return the places and the values of the entries of a row that are not 0."""
    if is_compressed(matrix):
        part = slice(matrix.indptr[row], matrix.indptr[row + 1])
        places, values = np.asarray(matrix.indices[part], dtype=np.intp), np.asarray(matrix.data[part])
        kept = values > 0
        return places[kept], values[kept]
    places = np.flatnonzero(matrix[row])
    return places, matrix[row, places]


def without_staying(state: int, symbols: npt.NDArray[np.intp], model: Vector) -> tuple[npt.NDArray[np.intp], Vector]:
    """Return the probabilities of the next state, given that it is another one; none where the model never leaves."""
    leaves = symbols != state
    rest = float(model[leaves].sum())
    return symbols[leaves], model[leaves] / rest if rest > 0 else model[leaves]


def row_of(
    action: int,
    state: int,
    symbols: npt.NDArray[np.intp],
    model: Vector,
    followed: Mapping[int, int],
    *,
    level: float = LEVEL,
) -> Row:
    """Return a row from the counts of its symbols."""
    counts = np.array([followed.get(symbol, 0) for symbol in symbols.tolist()], dtype=np.float64)
    known = set(symbols.tolist())
    impossible = tuple(sorted((symbol, count) for symbol, count in followed.items() if symbol not in known))
    interval = probability_intervals(counts, level=level) if len(counts) else (counts, counts, counts)
    return Row(action, state, symbols, model, counts, *interval, impossible)


def transition_rows(model: MDP, counts: Counts, kind: Kind, *, level: float = LEVEL) -> tuple[Row, ...]:
    """Return the rows of T that were visited, by action and state.

    Args:
        model: The model; factored ones are flattened.
        counts: See `counted`.
        kind: Of ``jumps`` the rows are those of another state that follows, without staying.
        level: The probability of the intervals.
    """
    flat = model.flatten()
    rows = []
    for (action, state), followed in sorted(counts.items()):
        symbols, probability = support(flat.transition_matrix(action), state)
        if kind == "jumps":
            symbols, probability = without_staying(state, symbols, probability)
        rows.append(row_of(action, state, symbols, probability, followed, level=level))
    return tuple(rows)


# -- Intervals ---------------------------------------------------------------------------------------------------------


class Interval(NamedTuple):
    """Estimates and the intervals around them.

    Attributes:
        estimates: The means of the posterior.
        low: The lower ends.
        high: The upper ends.
    """

    estimates: Vector
    low: Vector
    high: Vector


def check_level(level: object) -> float:
    """Return the level of intervals.

    Raises:
        ModelError: If it is not in (0, 1).
    """
    if is_number(level) and 0 < level < 1:
        return float(level)
    raise ModelError(f"the level of an interval is more than 0 and less than 1, not {level!r}")


def probability_intervals(counts: npt.ArrayLike, *, level: float = LEVEL) -> Interval:
    """Return the probabilities of a row, from the counts of the k entries that it may have.

    The posterior of an entry counted n_j times of n is Beta(n_j + 1/2, n - n_j + (k - 1)/2).

    Args:
        counts: k numbers; those of an expectation need not be whole.
        level: The probability of the intervals.

    Example:
        >>> interval = probability_intervals([8, 2])
        >>> [round(float(x), 3) for x in (interval.estimates[0], interval.low[0], interval.high[0])]
        [0.773, 0.493, 0.95]
    """
    from scipy.special import betaincinv  # noqa: PLC0415 - slow to import

    given = np.asarray(counts, dtype=np.float64)
    if len(given) == 1:
        certain = np.ones(1)
        return Interval(certain, certain, certain)
    heads = given + PRIOR
    tails = heads.sum() - heads
    tail = (1 - level) / 2
    return Interval(heads / heads.sum(), betaincinv(heads, tails, tail), betaincinv(heads, tails, 1 - tail))


def rate_intervals(counts: npt.ArrayLike, exposure: npt.ArrayLike, *, level: float = LEVEL) -> Interval:
    """Return rates a second, from counts of jumps and the seconds in which they could have come.

    The posterior of n jumps in t seconds is Gamma(n + 1/2, t). The time of stays that were cut short belongs to t.

    Example:
        >>> interval = rate_intervals([10], 20.0)
        >>> [round(float(x[0]), 3) for x in interval]
        [0.525, 0.257, 0.887]
    """
    from scipy.special import gammaincinv  # noqa: PLC0415 - slow to import

    shape = np.asarray(counts, dtype=np.float64) + PRIOR
    time = np.asarray(exposure, dtype=np.float64)
    tail = (1 - level) / 2
    return Interval(shape / time, gammaincinv(shape, tail) / time, gammaincinv(shape, 1 - tail) / time)


# -- Agreement ---------------------------------------------------------------------------------------------------------


class Verdict(msgspec.Struct, frozen=True):
    """The judgement of the counts of a row about the model.

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
    """Return the judgement of the counts about each row, in the order of the rows.

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
