"""Intervals: where a probability or a rate lies, after so many occurrences.

Both are equal-tailed intervals of Jeffreys' posterior, whose coverage at fixed true values is close to its level on the
average over samples (L. D. Brown, T. T. Cai and A. DasGupta, *Interval estimation for a binomial proportion*,
Statistical Science 16, 2001). For a row of k probabilities the prior is Dirichlet(1/2) **on the entries that the model
has**: the same prior on all states, of which a row has a few, covers half as often as it should.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.checks import is_number
from mdm.errors import ModelError

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector

__all__ = ["LEVEL", "PRIOR", "Interval", "check_level", "probability_intervals", "rate_intervals"]

LEVEL = 0.95
"""The probability of the intervals, by default."""
PRIOR = 0.5
"""What Jeffreys' prior adds to each count."""


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
