"""Rows of a report, against numpy and hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies

from mdm.latency import Report, Row
from mdm.runtime import Latencies


@given(strategies.lists(strategies.integers(1, 10**12), min_size=1, max_size=200))
def test_quantiles_are_numpys_and_the_histogram_has_each_once(nanoseconds):
    row = Row.of("in the loop", nanoseconds, undecided=2)
    assert (row.p50, row.p99) == pytest.approx(
        (np.quantile(nanoseconds, 0.5) / 1e9, np.quantile(nanoseconds, 0.99) / 1e9)
    )
    assert row.worst == max(nanoseconds) / 1e9
    assert (row.count, row.undecided) == (len(nanoseconds), 2)
    assert sum(count for _, count in row.histogram) == row.count
    for bound, count in row.histogram:
        assert count == sum(bound / 2 < each / 1e9 <= bound for each in nanoseconds)


def test_a_row_without_latencies_has_none():
    assert Row.of("x", [], undecided=3) == Row("x", undecided=3)


def test_rows_are_found_by_name():
    report = Report((Row("a"), Row("b", p50=1.0)), (), {}, 1.0)
    assert report.row("b").p50 == 1.0
    with pytest.raises(KeyError):
        report.row("c")


def test_a_histogram_says_its_median():
    latencies = Latencies()
    for nanoseconds in (1000, 1000, 1000, 10_000_000):
        latencies.record(nanoseconds)
    assert "median=1.02e-06 s" in repr(latencies.snapshot())  # the bound of an eighth of an octave from 896 on
