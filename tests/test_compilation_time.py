"""The compiler's stopwatch, with a clock that the test sets."""

from __future__ import annotations

import pytest

from mdm.compilation import COMPILE_TIME, CompileTime, working_time


@pytest.fixture
def watch():
    """Return a stopwatch, and a function that lets seconds pass."""
    now = [100.0]

    def after(seconds):
        now[0] += seconds

    return CompileTime(lambda: now[0]), after


def test_what_is_compiled_within_counts_once(watch):
    times, after = watch
    times.begin()
    after(1)
    times.begin()
    after(2)
    assert times.seconds == 3  # while it goes on
    times.end()
    after(4)
    times.end()
    after(8)
    assert times.seconds == 7
    with times.loading():
        after(0.5)
    assert times.seconds == 7.5


def test_who_waits_a_second_is_told_once(watch):
    times, after = watch
    calls = []
    with times.told(lambda: calls.append(times.seconds)):
        assert times.is_told
        with times.loading():
            after(5)
        for _ in range(4):  # functions that take a little each
            times.begin()
            after(0.4)
            times.go_on()
            times.end()
            after(10)
            times.go_on()  # of which nothing is compiled now
    assert calls == [pytest.approx(5 + 3 * 0.4)]
    assert not times.is_told
    times.begin()
    after(9)
    times.go_on()
    times.end()
    assert len(calls) == 1


def test_who_is_not_kept_waiting_is_told_nothing(watch):
    times, after = watch
    calls = []
    with times.told(lambda: calls.append(1)):
        times.begin()
        after(0.9)
        times.go_on()
        times.end()
    assert not calls


def test_working_time_stands_still_while_something_is_compiled(monkeypatch):
    monkeypatch.setattr("mdm.compilation.perf_counter", lambda: 50.0)
    monkeypatch.setattr(COMPILE_TIME, "_compiling", COMPILE_TIME._compiling + 20)
    assert working_time() == 50 - COMPILE_TIME.seconds
