from __future__ import annotations

import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import ConfigError
from mdm.team.transport.allowance import Allowance

SECOND = 1.0


@given(
    st.floats(0.5, 100),
    st.floats(0.1, 5),
    st.lists(st.tuples(st.floats(0, 1), st.sampled_from(["value", "bulk"])), max_size=200),
)
def test_no_more_passes_than_the_rate_and_a_burst(rate, burst, puts):
    allowance = Allowance(messages=rate, burst=burst)
    now, passed = 0.0, 0
    for pause, priority in puts:
        now += pause
        passed += allowance.spend(100, priority, now)
    assert passed <= rate * now / SECOND + max(round(rate * burst), 1) + 1e-6


def test_bytes_are_limited_too_and_what_is_larger_than_the_bucket_passes_alone():
    allowance = Allowance(bytes=1000)
    assert allowance.spend(5000, "value", 0)
    assert not allowance.spend(1, "value", 0)
    assert not allowance.spend(1, "value", SECOND)
    assert allowance.spend(1, "value", SECOND + 0.011)


def test_steps_always_pass_and_values_pay_for_them():
    allowance = Allowance(messages=10)
    assert all(allowance.spend(100, "step", 0) for _ in range(100))
    assert not allowance.spend(100, "value", SECOND)
    assert allowance.spend(100, "value", SECOND + 0.2)


def test_bulk_leaves_half_of_the_burst_to_values():
    allowance = Allowance(messages=10)
    assert [allowance.spend(1, "bulk", 0) for _ in range(10)].count(True) == 5
    assert [allowance.spend(1, "value", 0) for _ in range(10)].count(True) == 5


def test_it_may_be_changed_while_the_agent_runs():
    allowance = Allowance(messages=1000)
    allowance.messages = 1
    assert [allowance.spend(1, "value", 0) for _ in range(10)].count(True) == 1
    allowance.messages = None
    assert all(allowance.spend(1, "value", 0) for _ in range(10))
    allowance.bytes = 5
    assert (allowance.messages, allowance.bytes) == (None, 5)


@pytest.mark.parametrize("options", [{"messages": 0}, {"bytes": -1}, {"messages": "9"}, {"burst": 0}, {"bytes": True}])
def test_wrong_rates_are_refused(options):
    with refused(ConfigError):
        Allowance(**options)
