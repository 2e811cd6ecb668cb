"""The modes of an ensemble: stopped, deciding or safe, as a state machine of plain data.

Events are its methods; each returns the orders that the ensemble carries out, in their order. It knows no actor, no
clock and no event loop: the time of each event is handed in.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Final

from mdm.messages import Cause

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.messages import ModeName

__all__ = ["AT_INPUT", "AT_KNOWN", "AT_STIMULUS", "WAYS_BACK", "Modes", "Order"]


class Order(Enum):
    """What the ensemble is to do.

    Attributes:
        ADMIT: Run what is decided from now on.
        HALT: Cancel what lives, start nothing more, and tell when nothing lives.
        SECURE: Cancel what lives, start nothing that was or is decided, and run the safe action when nothing lives.
        RESUME: Decide again, after a safe mode.
        IDLE: Tell those who wait for the end: the ensemble is stopped, and its safe action has ended.
        EMERGENCY: Call what is left to do where the safe action has failed twice.
    """

    ADMIT = "admit"
    HALT = "halt"
    SECURE = "secure"
    RESUME = "resume"
    IDLE = "idle"
    EMERGENCY = "emergency"


WAYS_BACK: Final = {
    "impossible_observation": "at once",
    "deadline": "stimulus",
    "state": "stimulus",
    "policy": "stimulus",
    "stale_input": "known",
    "unknown_input": "known",
    "action": "input",
    "safe_action": "release",
    "lost_teammate": "team",
    "lost_majority": "team",
    "lost_controller": "team",
    "refused": "team",
    "failure": "restart",
    "end": "never",
}
"""What opens the way back from each cause, but for a person's `release`, which failures and the end do not heed."""

AT_STIMULUS: Final = frozenset(cause for cause, way in WAYS_BACK.items() if way == "stimulus")
"""Causes that are gone with the next stimulus, on which the ensemble then decides."""

AT_INPUT: Final = AT_STIMULUS | {cause for cause, way in WAYS_BACK.items() if way == "input"}
"""Causes that are gone with the next state or observation."""

AT_KNOWN: Final = AT_INPUT | {"unknown_input"}
"""Causes that are gone with the next state that is known, or observation."""

_FOR_GOOD = frozenset(cause for cause, way in WAYS_BACK.items() if way in {"restart", "never"})
_TRIES = 2

Orders = tuple[Order, ...]


class Modes:
    """The state machine.

    Causes not in `WAYS_BACK` are a user's own: they hold until they are gone or released.

    Args:
        time: When it begins.
        held: Causes that have outlasted what was before.

    Attributes:
        mode: The present one.
        since: When it began.
        causes: Why it is safe, by kind; each with its words and since when it holds. What only a release ends outlasts
            a stop.
        securing: Whether the safe action is due or runs.
    """

    __slots__ = ("_leaving", "_tries", "causes", "mode", "securing", "since")

    def __init__(self, time: int = 0, held: Iterable[Cause] = ()) -> None:
        self.mode: ModeName = "stopped"
        self.since = time
        self.causes = {cause.kind: cause for cause in held}
        self.securing = False
        self._tries = 0
        self._leaving = False

    @property
    def ended(self) -> bool:
        """Whether there is no way back for this life of the ensemble."""
        return not _FOR_GOOD.isdisjoint(self.causes)

    @property
    def leaving(self) -> bool:
        """Whether it is safe, and stopped when that is over."""
        return self._leaving

    @property
    def held(self) -> tuple[Cause, ...]:
        """The causes that nothing but a release, or a user's own word, takes away."""
        return tuple(cause for kind, cause in self.causes.items() if WAYS_BACK.get(kind, "release") == "release")

    # -- Events --------------------------------------------------------------------------------------------------

    def start(self, time: int) -> Orders:
        """The ensemble is to decide; where a cause has outlasted its stop, it is safe at once."""
        if self.mode == "safe":
            self._leaving = self._leaving and self.ended
            return ()
        if self.mode == "deciding" or self.ended:
            return ()
        if self.causes:
            return self._secure(time)
        self._enter("deciding", time)
        return (Order.ADMIT,)

    def stop(self, time: int) -> Orders:
        """The ensemble is to decide no more; a safe action that is due or runs comes to its end first."""
        if self.mode == "deciding":
            self._enter("stopped", time)
            return (Order.HALT,)
        if self.mode == "safe":
            self._leaving = True
            return self._leave(time)
        return ()

    def endanger(self, kind: str, detail: str, time: int) -> Orders:
        """Something went wrong."""
        if self.mode == "stopped":
            return ()
        if self.mode == "safe" and not self.securing and WAYS_BACK.get(kind) == "at once":
            return ()  # the robot is safe already, and nothing would ever take the cause away
        self.causes.setdefault(kind, Cause(kind, detail, time))
        return () if self.mode == "safe" else self._secure(time)

    def end(self, time: int, kind: str = "end", detail: str = "the ensemble ends", *, unsafe: bool = False) -> Orders:
        """There is no way back; the safe action runs once more, unless it is due or runs.

        Args:
            time: When.
            kind: The cause.
            detail: In words.
            unsafe: Whether an action has begun since the safe action last ran: it then runs where all has stopped, too.
        """
        self.causes.setdefault(kind, Cause(kind, detail, time))
        return () if self.securing or (self.mode == "stopped" and not unsafe) else self._secure(time)

    def gone(self, kinds: frozenset[str], time: int) -> Orders:
        """Causes hold no more."""
        for kind in kinds - _FOR_GOOD:
            self.causes.pop(kind, None)
        return self._leave(time) if self.mode == "safe" else ()

    def release(self, time: int) -> Orders:
        """A person says that it is over; a safe action that is due or runs comes to its end first."""
        return self.gone(frozenset(self.causes), time)

    def secured(self, failure: str | None, time: int, *, early: bool = False) -> Orders:
        """The safe action has ended, or failed.

        Args:
            failure: How it failed, or None.
            time: When.
            early: Whether it began before that which it is to have the last word over had ended: it runs once more.
        """
        if not self.securing:
            return ()
        if failure is not None and self._tries < _TRIES:
            self._tries += 1
            return (Order.SECURE,)
        alarm: Orders = ()
        if failure is not None:
            self.causes["safe_action"] = Cause("safe_action", failure, time)
            alarm = (Order.EMERGENCY,)
        if early:
            return (*alarm, *self._secure(time))
        self.securing = False
        if failure is None:
            self.causes.pop("impossible_observation", None)
        return (*alarm, *self._leave(time))

    # -- Transitions ---------------------------------------------------------------------------------------------

    def _enter(self, mode: ModeName, time: int) -> None:
        self.mode, self.since = mode, time

    def _secure(self, time: int) -> Orders:
        if self.mode != "safe":
            self._enter("safe", time)
        self.securing = True
        self._tries = 1
        return (Order.SECURE,)

    def _leave(self, time: int) -> Orders:
        """Leave the safe mode where nothing holds it any more."""
        if self.securing:
            return ()
        if self._leaving:
            self._leaving = False
            if not self.ended:
                self.causes = {cause.kind: cause for cause in self.held}
            self._enter("stopped", time)
            return (Order.IDLE,)
        if self.causes:
            return ()
        self._enter("deciding", time)
        return (Order.RESUME,)
