"""The clock of a replay: it is moved from stimulus to stimulus, and timers fire on the way, each at its time."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from mdm.replay.driver import ReplayClock


def test_it_shows_the_time_to_which_it_was_moved():
    clock = ReplayClock(100)
    assert clock.now() == 100
    assert not clock.step(250)
    assert clock.now() == 250
    assert not clock.step(200)  # a stimulus that is stamped earlier turns no time back
    assert clock.now() == 250


@given(st.lists(st.integers(0, 50)), st.integers(0, 60))
def test_timers_fire_one_by_one_in_the_order_of_their_times(times, until):
    clock = ReplayClock(0)
    fired = []
    for number, time in enumerate(times):
        clock.call_at(time, lambda time=time, number=number: fired.append((clock.now(), time, number)))
    while clock.step(until):
        pass
    assert fired == [
        (time, time, number)
        for time, number in sorted((time, number) for number, time in enumerate(times))
        if time <= until
    ]
    assert clock.now() == until


def test_a_timer_may_set_one_that_comes_before_the_next():
    clock = ReplayClock(0)
    fired = []
    clock.call_at(10, lambda: clock.call_at(15, lambda: fired.append(clock.now())))
    clock.call_at(20, lambda: fired.append(clock.now()))
    while clock.step(30):
        pass
    assert fired == [15, 20]


def test_a_stimulus_fires_no_timer_by_itself():
    clock = ReplayClock(0)
    clock.call_at(10, lambda: pytest.fail("it fires"))
    clock.fire_before(50)


def test_ticks_come_from_the_record_alone():
    clock = ReplayClock(0)
    timer = clock.call_at(10, lambda: pytest.fail("it fires"), rank=1)
    assert not clock.step(100)
    timer.cancel()
