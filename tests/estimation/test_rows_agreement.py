"""Agreement of rows with the model, against scipy's tests."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy
from hypothesis import given, strategies as st

from mdm.estimation.rows import discoveries, g_test, log_odds, row_of, verdicts

counts_of = st.lists(st.integers(0, 60), min_size=2, max_size=6).filter(any)


def evenly(size):
    weights = np.arange(1, size + 1, dtype=float)
    return weights / weights.sum()


@given(counts_of)
def test_the_g_test_is_scipy_s(counts):
    model = evenly(len(counts))
    expected = scipy.stats.power_divergence(counts, sum(counts) * model, lambda_="log-likelihood").pvalue
    assert g_test(np.array(counts, dtype=float), model) == pytest.approx(expected, rel=1e-9, abs=1e-300)


@given(st.lists(st.floats(0, 1), max_size=30), st.sampled_from([0.01, 0.05, 0.2]))
def test_discoveries_are_those_of_benjamini_and_hochberg(values, rate):
    expected = scipy.stats.false_discovery_control(values) <= rate if values else np.zeros(0, dtype=bool)
    adjusted = scipy.stats.false_discovery_control(values) if values else []
    clear = [abs(each - rate) > 1e-12 for each in adjusted]  # on the limit rounding decides
    assert discoveries(values, rate)[clear].tolist() == np.asarray(expected)[clear].tolist()


@given(counts_of)
def test_the_odds_are_the_product_of_the_mixture_s_predictions(counts):
    """Polya's urn, in fractions: (n_j + 1/2) / (n + k/2) at each draw, in any order."""
    model = [Fraction(place + 1, sum(range(1, len(counts) + 1))) for place in range(len(counts))]
    odds, seen = Fraction(1), [0] * len(counts)
    for place, count in enumerate(counts):
        for _ in range(count):
            odds *= (seen[place] + Fraction(1, 2)) / (sum(seen) + Fraction(len(counts), 2)) / model[place]
            seen[place] += 1
    expected = math.log(odds.numerator) - math.log(odds.denominator)
    assert log_odds(np.array(counts, dtype=float), np.array(model, dtype=float)) == pytest.approx(expected, abs=1e-9)


def row(counts, model, impossible=()):
    symbols = np.arange(len(model))
    return row_of(0, 0, symbols, np.array(model), dict(enumerate(counts)) | dict(impossible))


def test_rows_are_told_apart():
    rows = [
        row([100, 0], [0.5, 0.5]),
        row([52, 48], [0.5, 0.5]),
        row([2, 2], [0.5, 0.5]),
        row([9], [1.0]),
        row([5, 5], [0.5, 0.5], [(7, 1)]),
    ]
    found = verdicts(rows)
    assert [each.says for each in found] == ["differs", "agrees", "too few", "certain", "differs"]
    assert [each.p_value is None for each in found] == [False, False, True, True, True]
    assert found[-1].log_odds == math.inf


def test_other_p_values_may_be_given():
    rows = [row([52, 48], [0.5, 0.5]), row([2, 2], [0.5, 0.5])]
    assert [each.says for each in verdicts(rows, p_values=[1e-9, 1e-9])] == ["differs", "too few"]


def test_few_of_many_rows_that_agree_are_said_to_differ():
    random = np.random.default_rng(5)
    rows = [row(random.multinomial(30, [0.7, 0.2, 0.1]), [0.7, 0.2, 0.1]) for _ in range(400)]
    assert sum(each.says == "differs" for each in verdicts(rows)) <= 2


def test_wrong_rows_are_found_among_right_ones():
    random = np.random.default_rng(6)
    truth = [[0.4, 0.6] if place < 3 else [0.7, 0.3] for place in range(60)]
    rows = [row(random.multinomial(333, each), [0.7, 0.3]) for each in truth]
    assert [each.says == "differs" for each in verdicts(rows)] == [True] * 3 + [False] * 57
