"""Intervals of probabilities and rates, against scipy's distributions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from hypothesis import given, strategies as st

from mdm import ModelError
from mdm.estimation.rows import check_level, probability_intervals, rate_intervals


@given(st.lists(st.integers(0, 1000), min_size=2, max_size=8), st.floats(0.5, 0.99))
def test_probabilities_are_those_of_jeffreys_posterior(counts, level):
    interval = probability_intervals(counts, level=level)
    tail = (1 - level) / 2
    for place, count in enumerate(counts):
        rest = sum(counts) - count + (len(counts) - 1) / 2
        posterior = scipy.stats.beta(count + 0.5, rest)
        assert interval.estimates[place] == pytest.approx(posterior.mean())
        assert interval.low[place] == pytest.approx(posterior.ppf(tail), rel=1e-6, abs=1e-12)
        assert interval.high[place] == pytest.approx(posterior.ppf(1 - tail), rel=1e-6)
    assert sum(interval.estimates) == pytest.approx(1)


def test_the_only_entry_of_a_row_is_certain():
    assert [list(each) for each in probability_intervals([7])] == [[1.0]] * 3


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=8), st.floats(1e-3, 1e6))
def test_rates_are_those_of_jeffreys_posterior(counts, exposure):
    interval = rate_intervals(counts, exposure)
    for place, count in enumerate(counts):
        posterior = scipy.stats.gamma(count + 0.5, scale=1 / exposure)
        assert interval.estimates[place] == pytest.approx(posterior.mean())
        assert interval.low[place] == pytest.approx(posterior.ppf(0.025), rel=1e-6)
        assert interval.high[place] == pytest.approx(posterior.ppf(0.975), rel=1e-6)


@pytest.mark.parametrize("size", [2, 3, 5])
def test_a_row_s_interval_covers_as_often_as_it_says_on_the_average(size):
    """Exactly, by the binomial distribution of each count, over rows drawn evenly."""
    rows = np.random.default_rng(1).dirichlet(np.ones(size), 200)
    for visits in (10, 40):
        counts = np.arange(visits + 1)
        shapes = counts + 0.5, visits - counts + (size - 1) / 2
        low, high = (scipy.stats.beta.ppf(q, *shapes) for q in (0.025, 0.975))
        chances = scipy.stats.binom.pmf(counts[:, None], visits, rows.ravel())
        covered = (low[:, None] <= rows.ravel()) & (rows.ravel() <= high[:, None])
        assert 0.93 < (chances * covered).sum(axis=0).mean() < 0.97
        ours = [probability_intervals([n, *[(visits - n) / (size - 1)] * (size - 1)]) for n in counts.tolist()]
        assert [each.low[0] for each in ours] == pytest.approx(low.tolist())


def test_a_level_is_a_probability():
    assert check_level(0.9) == 0.9
    with pytest.raises(ModelError, match="more than 0 and less than 1, not 95"):
        check_level(95)
