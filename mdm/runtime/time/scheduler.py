"""The scheduler: fixed-rate ticks, aligned to multiples of their period."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Literal

from mdm.checks import check_choice, is_number
from mdm.errors import ConfigError
from mdm.messages import Tick

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.runtime.time.clock import Clock, Timer


def check_rate(rate: object, *, key: str | None = None) -> None:
    """Refuse a rate, in ticks per second, that no clock could serve.

    Raises:
        ConfigError: If it is no number, below a millionth, or above a million.
    """
    if not is_number(rate) or not 1e-6 <= rate <= 1e6:
        raise ConfigError(f"a rate is at least 0.000001 and at most 1,000,000 a second, not {rate!r}", key=key)


def next_tick(now: int, rate: float) -> int:
    """Return the number of the first tick of a rate at or after a time in nanoseconds."""
    period = _period(rate)
    return -(-now * period.denominator // period.numerator)


def _period(rate: float) -> Fraction:
    return 1_000_000_000 / Fraction(float(rate)).limit_denominator(1_000_000)


class Ticker:
    """Ticks at ``rate`` per second, at whole multiples of the period since the clock's epoch.

    The time of each tick is computed from its number, never from the tick before, so that it does not drift; tickers
    of one rate on synchronised clocks tick together. The first tick is due now, where now is a multiple.

    Args:
        clock: Whose time.
        rate: Ticks per second.
        deliver: Called with each `Tick`.
        overrun: When ticks were missed, ``skip`` them (counted in ``missed``), or deliver each as a ``burst``.
        since: From when on, in nanoseconds; by default now.
    """

    __slots__ = (
        "__weakref__",
        "_clock",
        "_deliver",
        "_denominator",
        "_missed",
        "_number",
        "_numerator",
        "_overrun",
        "_timer",
        "missed",
        "ticks",
    )

    def __init__(
        self,
        clock: Clock,
        rate: float,
        deliver: Callable[[Tick], object],
        *,
        overrun: Literal["skip", "burst"] = "skip",
        since: int | None = None,
    ) -> None:
        check_rate(rate)
        check_choice(overrun, ("skip", "burst"), "overrun", key="overrun")
        self._clock = clock
        period = _period(rate)
        self._numerator, self._denominator = period.numerator, period.denominator
        self._deliver = deliver
        self._overrun = overrun
        self.ticks = 0
        self.missed = 0
        self._missed: int | None = None  # by the tick that stands for them, once they have been counted
        self._number = next_tick(clock.now() if since is None else since, rate)
        self._timer: Timer = clock.call_at(self._due(self._number), self._fire, rank=1)

    def _due(self, number: int) -> int:
        return -(-number * self._numerator // self._denominator)

    def _fire(self) -> None:
        due = self._due(self._number)
        now = self._clock.now()
        missed, self._missed = self._missed, None
        if missed is None:
            missed = 0
            if self._overrun == "skip":
                missed = max(now * self._denominator // self._numerator - self._number, 0)
            if missed:  # the tick that stands for all comes at its own time, behind what is due before that
                self._missed = missed
                self._number += missed
                self._timer = self._clock.call_at(self._due(self._number), self._fire, rank=1)
                return
        self.tick(Tick(due, self._number, now - due, missed))

    def tick(self, tick: Tick) -> None:
        """Tick now, and go on with the next number."""
        self._timer.cancel()
        self.missed += tick.missed
        self.ticks += 1
        self._number = tick.number + 1
        self._timer = self._clock.call_at(self._due(self._number), self._fire, rank=1)
        self._deliver(tick)

    def cancel(self) -> None:
        """Tick no more."""
        self._timer.cancel()
