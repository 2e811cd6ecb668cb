"""The timer device: it fires once, at its time, and can be waited for as a file."""

from __future__ import annotations

import os
import select
import time

import pytest
from patience import PATIENCE

from mdm.runtime.time import clock as timerfd

pytestmark = pytest.mark.skipif(not timerfd.available, reason="this platform has no timerfd")


@pytest.fixture
def timer():
    descriptor = timerfd.create()
    yield descriptor
    timerfd.close(descriptor)


def fires(timer):
    return bool(select.select([timer], [], [], PATIENCE)[0])


@pytest.mark.parametrize("ahead", [2_000_000, 0, -1_000_000_000])
def test_it_fires_once_and_never_early(timer, ahead):
    assert not timerfd.acknowledge(timer)
    due = time.monotonic_ns() + ahead
    timerfd.set_time(timer, due)
    assert fires(timer)
    assert time.monotonic_ns() >= due
    assert timerfd.acknowledge(timer)
    assert not timerfd.acknowledge(timer)


def test_a_new_time_takes_the_place_of_the_old_one(timer):
    timerfd.set_time(timer, time.monotonic_ns() + 3600 * 10**9)
    timerfd.set_time(timer, 0)  # has passed, rather than never
    assert fires(timer)


def test_programs_that_are_started_do_not_get_it(timer):
    assert not os.get_inheritable(timer)
    assert not os.get_blocking(timer)
