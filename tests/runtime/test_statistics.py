"""Latencies, against the list of them."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from mdm.runtime import Latencies


@given(st.lists(st.integers(1, 10**10), min_size=1, max_size=200))
def test_latencies_are_exact_to_an_eighth_of_an_octave(values):
    latencies = Latencies()
    for value in values:
        latencies.record(value)
    histogram = latencies.snapshot()
    assert histogram.count == len(values)
    assert histogram.total == pytest.approx(sum(values) / 1e9)
    assert histogram.maximum == max(values) / 1e9
    for fraction in (0.1, 0.5, 0.9, 1.0):
        rank = max(1, -(-fraction * len(values) // 1))
        exact = sorted(values)[int(rank) - 1] / 1e9
        assert exact <= histogram.quantile(fraction) * (1 + 1e-9) <= exact * 1.2 + 2e-9


def test_a_histogram_prints_in_one_line():
    latencies = Latencies()
    assert repr(latencies.snapshot()) == "Histogram(count=0)"
    for _ in range(4):
        latencies.record(2_000_000)
    text = repr(latencies.snapshot())
    assert text.startswith("Histogram(count=4, mean=0.002 s, ")
    assert text.endswith("maximum=0.002 s)")
