"""A clock whose event loop is held: its time moves while nothing fires, and timers come late when the test says so."""

from __future__ import annotations

import asyncio

import mdm
from mdm.runtime import Clock

__all__ = ["START", "HeldClock", "recorded"]

START = 1_795_651_000_000_000_000
"""A time of the wall clock, in nanoseconds: that of the year 2026."""
_MS = 1_000_000


class HeldClock(Clock):
    """Shows the time that a test sets."""

    def __init__(self):
        super().__init__()
        self.shown = START

    def now(self):
        return self.shown

    def _arm(self, when):
        """Wait for the test."""

    def hold_until(self, milliseconds):
        """Let time go on to so many milliseconds since the start, with the event loop held: no timer fires."""
        self.shown = START + round(milliseconds * _MS)

    def let_go(self):
        """Let the timers fire that are due by now."""
        while self.due <= self.shown:
            self._fire_due()


def recorded(path, tops, happen):
    """Record actors on a held clock while a coroutine function has things happen; return what is decided.

    Args:
        path: The record.
        tops: The actors at the top.
        happen: Called with the clock, when they run.
    """
    decisions = []

    async def main():
        clock = HeldClock()
        async with mdm.Runtime(clock=clock, log=False, watchdog=None, record=path) as runtime:
            runtime.decisions.subscribe(decisions.append)
            for top in tops:
                await runtime.start(top)
            await happen(clock)

    asyncio.run(main())
    return decisions
