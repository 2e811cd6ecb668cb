"""The modes of an ensemble, stopped, deciding or safe, and the stages of its end, as a state machine of plain data.

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


class Order(Enum):
    """An order to the ensemble.

    Attributes:
        ADMIT: Run the actions decided from now on.
        HALT: Cancel all lives, start no more, and notify when none is left.
        SECURE: Cancel all lives, start no decided action, and run the safe action when none is left.
        RESUME: Decide again, after a safe mode.
        IDLE: Notify the callers that wait for the end: the ensemble is stopped, and its safe action has ended.
        EMERGENCY: Call the last resort, since the safe action has failed twice.
    """

    ADMIT = "admit"
    HALT = "halt"
    SECURE = "secure"
    RESUME = "resume"
    IDLE = "idle"
    EMERGENCY = "emergency"


class Stage(Enum):
    """How far a life of the ensemble has come; it goes through them in this order.

    Attributes:
        CLOSED: No life has begun.
        OPEN: It starts and stops as it is told.
        LATCHED: An ensemble above it ends: nothing of it starts any more.
        BELOW: It ends, and the ensembles below it come first.
        LAST: It ends, and its safe action has the last word.
        OVER: It has ended.
    """

    CLOSED = 0
    OPEN = 1
    LATCHED = 2
    BELOW = 3
    LAST = 4
    OVER = 5


class Aim(Enum):
    """The ensemble's aim, as last told: it says what follows a safe mode.

    Attributes:
        REST: It has been told nothing: it may go safe before its start, and is stopped again when no cause holds.
        DECIDE: It decides, and again when no cause holds; at its end, when nothing follows, it stays safe.
        STOP: Somebody has told it to stop, and not to start since: it is stopped when its safe action has ended.
    """

    REST = "rest"
    DECIDE = "decide"
    STOP = "stop"


class Try(Enum):
    """How the safe action stands.

    Attributes:
        NONE: It is not due.
        FIRST: It is due or runs.
        SECOND: It has failed, and is due once more or runs again.
        OWED: It has failed, and runs again when the ensembles below have ended.
    """

    NONE = 0
    FIRST = 1
    SECOND = 2
    OWED = 3


WAYS_BACK: Final = {
    "impossible_observation": "at once",
    "deadline": "stimulus",
    "state": "stimulus",
    "policy": "stimulus",
    "stale_input": "known",
    "unknown_input": "known",
    "action": "input",
    "starved": "turn",
    "safe_action": "release",
    "lost_teammate": "team",
    "missing_teammate": "team",
    "lost_majority": "team",
    "lost_controller": "team",
    "refused": "team",
    "failure": "restart",
    "end": "never",
}
"""The way back from each cause, but for a person's `release`, which failures and the end do not heed."""

AT_STIMULUS: Final = frozenset(cause for cause, way in WAYS_BACK.items() if way == "stimulus")
"""Causes that are gone with the next stimulus, on which the ensemble then decides."""

AT_INPUT: Final = AT_STIMULUS | {cause for cause, way in WAYS_BACK.items() if way == "input"}
"""Causes that are gone with the next state or observation."""

AT_KNOWN: Final = AT_INPUT | {"unknown_input"}
"""Causes that are gone with the next state that is known, or observation."""

_FOR_GOOD = frozenset(cause for cause, way in WAYS_BACK.items() if way in {"restart", "never"})

Orders = tuple[Order, ...]


class Modes:
    """The state machine.

    Causes not in `WAYS_BACK` are a user's own: they hold until they are gone or released.

    Args:
        time: When it begins.
        held: Causes that have outlasted the life before.

    Attributes:
        mode: The present one.
        since: When it began.
        causes: Why it is safe, by kind; each with its words and since when it holds. A cause that only a release ends
            outlasts a stop.
        stage: How far its life has come.
        safe_action: How the safe action stands.
        aim: What it was told last.
    """

    __slots__ = ("aim", "causes", "mode", "safe_action", "since", "stage")

    def __init__(self, time: int = 0, held: Iterable[Cause] = ()) -> None:
        self.mode: ModeName = "stopped"
        self.since = time
        self.causes = {cause.kind: cause for cause in held}
        self.stage = Stage.CLOSED
        self.safe_action = Try.NONE
        self.aim = Aim.REST

    @property
    def deciding(self) -> bool:
        """Whether it may decide."""
        return self.mode == "deciding" and self.stage is Stage.OPEN

    @property
    def securing(self) -> bool:
        """Whether the safe action is due or runs."""
        return self.safe_action is not Try.NONE

    @property
    def ending(self) -> bool:
        """Whether it comes to its end, or has."""
        return self.stage.value >= Stage.BELOW.value

    @property
    def ended(self) -> bool:
        """Whether there is no way back for this life of the ensemble."""
        return not _FOR_GOOD.isdisjoint(self.causes)

    @property
    def leaving(self) -> bool:
        """Whether it is safe, and stopped when that is over."""
        return self.mode == "safe" and self.aim is not Aim.DECIDE

    @property
    def held(self) -> tuple[Cause, ...]:
        """The causes that outlast a stop: a release, the team or a user's own word takes them away, and no input."""
        return tuple(
            cause for kind, cause in self.causes.items() if WAYS_BACK.get(kind, "release") in {"release", "team"}
        )

    # -- Stages --------------------------------------------------------------------------------------------------

    def open(self, time: int) -> None:
        """A life begins, stopped: it keeps the causes that a restart does not mend."""
        held = self.held if "failure" in self.causes else ()
        self.aim = Aim.REST
        self.safe_action = Try.NONE
        self.causes = {cause.kind: cause for cause in held}
        self.stage = Stage.OPEN
        self._enter("stopped", time)

    def latch(self) -> None:
        """An ensemble above ends: nothing starts any more; running lives end on their own."""
        if self.stage is Stage.OPEN:
            self.stage = Stage.LATCHED

    def end_below(self) -> bool:
        """The end begins with the ensembles below; return whether it had not begun."""
        begins = self.stage in {Stage.OPEN, Stage.LATCHED}
        if begins:
            self.stage = Stage.BELOW
        return begins

    def end_here(self) -> None:
        """The ensembles below have ended: a safe action that ran before, for another cause, is not the last word."""
        self.stage = Stage.LAST

    def finish(self) -> bool:
        """The last word is said; return whether it had not been."""
        ends = self.stage is not Stage.OVER
        self.stage = Stage.OVER
        return ends

    def close(self) -> None:
        """Nothing of the life is left that could be made safe."""
        self.stage = Stage.OVER if self.ending else Stage.CLOSED

    # -- Events --------------------------------------------------------------------------------------------------

    def start(self, time: int) -> Orders:
        """The ensemble is to decide; where a cause has outlasted its stop, it is safe at once."""
        if self.stage is not Stage.OPEN:
            return ()
        if not self.ended:
            self.aim = Aim.DECIDE
        if self.mode != "stopped" or self.ended:
            return ()
        if self.causes:
            return self._secure(time)
        self._enter("deciding", time)
        return (Order.ADMIT,)

    def stop(self, time: int) -> Orders:
        """The ensemble is to decide no more; a safe action that is due or runs comes to its end first.

        An ensemble that ends with those below it is made safe all the same.
        """
        if self.stage is Stage.BELOW:
            return ()
        self.aim = Aim.STOP
        if self.mode == "deciding":
            self._enter("stopped", time)
            return (Order.HALT,)
        return self._leave(time) if self.mode == "safe" else ()

    def endanger(self, kind: str, detail: str, time: int, *, at_rest: bool = False) -> Orders:
        """Something went wrong; where it has stopped, that is kept for its start.

        Args:
            kind: The cause.
            detail: In words.
            time: When.
            at_rest: Whether it goes safe where it has not started, too; not where somebody has told it to stop.
        """
        stopped = self.mode == "stopped"
        if stopped and self.stage is not Stage.OPEN:
            return ()
        if self.mode != "deciding" and not self.securing and WAYS_BACK.get(kind) == "at once":
            return ()  # the robot is safe already, or stands, and nothing would ever take the cause away
        self.causes.setdefault(kind, Cause(kind, detail, time))
        if self.mode == "safe" or (stopped and (self.aim is Aim.STOP or not at_rest)):
            return ()
        return self._secure(time)

    def end(self, time: int, kind: str = "end", detail: str = "the ensemble ends", *, unsafe: bool = False) -> Orders:
        """There is no way back, behind `end_here`; the safe action runs once more, unless it is due or runs.

        Args:
            time: When.
            kind: The cause.
            detail: In words.
            unsafe: Whether an action has begun since the safe action last ran: it then runs where all has stopped, too.
        """
        self.causes.setdefault(kind, Cause(kind, detail, time))
        if self.safe_action is Try.OWED:
            self.safe_action = Try.SECOND
            return (Order.SECURE,)
        if self.securing or (self.mode == "stopped" and not unsafe):
            return ()
        if self.mode == "stopped":
            self.aim = Aim.DECIDE
        return self._secure(time)

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
            early: Whether it began before the lives and ensembles below had ended: as the last word of an end, it
                runs once more.
        """
        if not self.securing:
            return ()
        if failure is not None and self.safe_action is Try.FIRST:
            if self.stage is Stage.BELOW:  # not beside the safe actions of the ensembles there
                self.safe_action = Try.OWED
                return ()
            self.safe_action = Try.SECOND
            return (Order.SECURE,)
        alarm: Orders = ()
        if failure is not None:
            self.causes["safe_action"] = Cause("safe_action", failure, time)
            alarm = (Order.EMERGENCY,)
        if early and self.stage is Stage.LAST:
            return (*alarm, *self._secure(time))
        self.safe_action = Try.NONE
        if failure is None:
            self.causes.pop("impossible_observation", None)
        return (*alarm, *self._leave(time))

    # -- Transitions ---------------------------------------------------------------------------------------------

    def _enter(self, mode: ModeName, time: int) -> None:
        self.mode, self.since = mode, time

    def _secure(self, time: int) -> Orders:
        if self.mode != "safe":
            self._enter("safe", time)
        self.safe_action = Try.FIRST
        return (Order.SECURE,)

    def _leave(self, time: int) -> Orders:
        """Leave the safe mode where nothing holds it any more."""
        if self.securing:
            return ()
        if self.aim is Aim.STOP or (self.aim is Aim.REST and not self.causes):
            if not self.ended:
                self.causes = {cause.kind: cause for cause in self.held}
            self._enter("stopped", time)
            return (Order.IDLE,)
        if self.causes:
            return ()
        self._enter("deciding", time)
        return (Order.RESUME,) if self.stage is Stage.OPEN else ()  # at its end it is made safe once more
