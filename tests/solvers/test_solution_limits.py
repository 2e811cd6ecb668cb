"""Limits, reports, interruption."""

from __future__ import annotations

import signal
import threading

import pytest
from sentences import refused

from mdm import ConfigError, ModelError
from mdm.solvers import Limits


def ticking(step=1.0):
    now = iter(step * k for k in range(10_000))
    return lambda: next(now)


@pytest.mark.parametrize(
    ("limits", "bounds", "reason"),
    [
        ({"gap": 0.5}, (1.0, 1.5), "gap"),
        ({"gap": 0.5}, (1.0, 1.6), None),
        ({"iterations": 3}, (0.0, 9.0), "iterations"),
        ({"iterations": 4}, (0.0, 9.0), None),
        ({"memory": 1}, (0.0, 9.0), "memory"),
        ({"time": 0}, (0.0, 9.0), "time"),
    ],
)
def test_each_limit_ends_a_run(limits, bounds, reason):
    limits = Limits(**{"gap": 1e-9, **limits})
    with limits:
        assert limits.ends(*bounds, iterations=3, size=1) is (reason is not None)
    assert limits.reason == reason


def test_time_is_that_of_the_clock():
    limits = Limits(gap=0, time=3, clock=ticking())
    with limits:
        ends = [limits.ends(0, 1, iterations=k, size=1) for k in range(4)]
    assert ends == [False, False, True, True]
    assert limits.reason == "time"


def test_every_report_is_told_and_the_history_stays_short():
    told = []
    limits = Limits(gap=0, progress=told.append, clock=ticking())
    with limits:
        for k in range(1000):
            limits.ends(0, 1, iterations=k, size=2)
    history = limits.solution("policy", "name", 0, 1, iterations=1000, size=2).history
    assert [p.iterations for p in told] == list(range(1000))
    assert len(history) < 150
    assert [p.seconds for p in history] == sorted(p.seconds for p in history)
    assert history[-1].iterations == 1000


def test_who_is_told_may_end_a_run():
    told = []

    def tell(progress):
        told.append(progress)
        return len(told) == 3

    limits = Limits(gap=0, progress=tell)
    with limits:
        assert [limits.ends(0, 1, iterations=k, size=1) for k in range(3)] == [False, False, True]
        assert limits.remaining < 0
    assert limits.reason == "interrupted"


def test_what_nothing_stopped_is_exact():
    limits = Limits()
    found = limits.solution("policy", "name", 1.0, 1.0, iterations=7, size=2)
    assert (found.reason, found.gap, found.iterations) == ("exact", 0.0, 7)


def test_the_second_ctrl_c_breaks_off():
    limits = Limits()
    with limits:
        signal.raise_signal(signal.SIGINT)
        assert limits.remaining < 0
        assert limits.ends(0, 1, iterations=1, size=1)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert limits.reason == "interrupted"


def test_a_solver_within_a_block_of_its_limits_gives_ctrl_c_back_as_the_block_found_it():
    before = signal.getsignal(signal.SIGINT)
    ticks = iter([0.0, 1.0, 3.0, 6.0])
    with Limits(clock=lambda: next(ticks)) as limits:  # two readings: it is made, and entered
        during = signal.getsignal(signal.SIGINT)
        with limits as run:
            assert run.seconds == 3.0 - 1.0  # as the outer block counts
        assert signal.getsignal(signal.SIGINT) == during != before
        assert limits.seconds == 6.0 - 1.0
    assert signal.getsignal(signal.SIGINT) is before


def test_what_a_shell_ignores_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with Limits() as limits:
            signal.raise_signal(signal.SIGINT)
            assert not limits.ends(0, 1, iterations=1, size=1)
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_in_another_thread_signals_are_left_alone():
    handlers = []
    before = signal.getsignal(signal.SIGINT)

    def work():
        with Limits() as limits:
            handlers.append(signal.getsignal(signal.SIGINT))
            limits.interrupt()
            handlers.append(limits.ends(0, 1, iterations=1, size=1))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [before, True]


def test_limits_below_zero_and_bounds_that_are_no_numbers_are_refused():
    with refused(ConfigError):
        Limits(time=-1)
    with refused(ConfigError):
        Limits(gap=float("nan"))
    with refused(ModelError):
        Limits().ends(float("nan"), 1, iterations=1, size=1)


def test_a_part_of_the_time():
    limits = Limits(time=10, clock=ticking())
    with limits:
        goes_on = limits.part(0.5)
        left = [goes_on() for _ in range(10)]
        assert 1 <= left.count(True) <= 5
        assert left == sorted(left, reverse=True)
        rest = limits.part(1.0)
        limits.interrupt()
        assert not rest()
    assert Limits().part(0.1)()
