"""Token buckets keep their bound in any interval of time, and waste nothing of it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm.team import TokenBucket

RATES = st.floats(0.01, 100)
PAUSES = st.lists(st.floats(0, 20), min_size=1, max_size=60)


@given(rate=RATES, burst=st.integers(1, 5), pauses=PAUSES)
def test_no_interval_has_more_than_it_may(rate, burst, pauses):
    bucket = TokenBucket(rate, burst)
    now, admitted = 0.0, []
    for pause in pauses:
        now += pause
        if bucket.take(now):
            admitted.append(now)
    for first, begin in enumerate(admitted):
        for last in range(first, len(admitted)):
            assert last - first + 1 <= burst + rate * (admitted[last] - begin) + 1e-6
    assert bucket.taken == len(admitted)
    assert bucket.taken + bucket.held_back == len(pauses)


@given(rate=RATES, burst=st.integers(1, 5))
def test_after_a_pause_a_whole_burst_passes_and_then_the_rate(rate, burst):
    bucket = TokenBucket(rate, burst)
    assert [bucket.take(1000.0) for _ in range(burst + 1)] == [True] * burst + [False]
    assert bucket.take(1000.0 + 1.001 / rate)
    assert not bucket.take(1000.0 + 1.002 / rate)


def test_tokens_are_owed_a_burst_at_most_and_a_smaller_burst_counts_at_once():
    bucket = TokenBucket(10, 20)
    bucket.pay(100)
    assert bucket.level(5.0) == -20
    assert bucket.level(6.0) == pytest.approx(-10)
    assert bucket.level(5.0) == pytest.approx(-10)  # time that goes back fills nothing
    assert bucket.level(60.0) == 20
    bucket.burst = 3
    assert bucket.level(60.0) == 3


@pytest.mark.parametrize("rate", [0, -1, math.inf, math.nan, True, "2"])
def test_rates_that_are_none(rate):
    with refused(mdm.ConfigError):
        TokenBucket(rate)


@pytest.mark.parametrize("burst", [0, -1, 1.5, True])
def test_bursts_that_are_none(burst):
    with refused(mdm.ConfigError):
        TokenBucket(1.0, burst)
