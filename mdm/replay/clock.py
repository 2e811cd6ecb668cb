"""The clock of a replay: it shows what the record says, and its timers fire when it is moved on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.runtime.time.clock import Timer
from mdm.runtime.time.virtual import VirtualClock

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ReplayClock"]


class ReplayClock(VirtualClock):
    """A clock that whoever repeats a run moves from stimulus to stimulus.

    Ticks are stimuli of the record: a timer of their rank never fires by itself.

    Args:
        epoch: The time that it shows at first, in nanoseconds.
    """

    def __init__(self, epoch: int) -> None:
        super().__init__(epoch=epoch)
        self._time = epoch

    def now(self) -> int:
        """Return the time to which it was moved."""
        return self._time

    def call_at(self, when: int, callback: Callable[[], None], *, rank: int = 0) -> Timer:
        """Call back when it is moved to ``when`` nanoseconds or beyond."""
        if rank:
            return Timer(when, callback)
        return super().call_at(when, callback)

    def _arm(self, when: int) -> None:
        """Wait to be moved."""

    def fire_before(self, when: int) -> None:
        """Leave timers to `step`."""

    def step(self, until: int) -> bool:
        """Fire the first timer that is due by a time, at its time; return whether there was one."""
        self._look_at_next()
        if self.due > until:
            self._time = max(self._time, until)
            return False
        self._time = max(self._time, self.due)
        self.fire_first()
        return True
