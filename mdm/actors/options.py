"""The options of control layers, of ensembles and of actions, for Python, files and commands; and drives."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypedDict

import msgspec
from msgspec import Meta

from mdm.checks import is_number
from mdm.errors import ConfigError
from mdm.options import ControllerOptions, ControllerSettings, Options, Seconds
from mdm.runtime.time.scheduler import check_rate

AfterSafe = Literal["reset", "keep"]
FailureReaction = Literal["safe", "continue", "decide"]
SAFE_TIMEOUT = 10.0
LostTeammate = Literal["continue", "hold", "safe_action"]
OnRepeat = Literal["continue", "restart"]
Reaction = Literal["safe", "continue"]
Then = Literal["wait", "decide"]


class OnEvent(msgspec.Struct, frozen=True):
    """Decide on each state or observation, as it comes."""


class FixedRate(msgspec.Struct, frozen=True):
    """Decide ``rate`` times a second, at times aligned to whole periods, on the latest state or observation."""

    rate: float

    def __post_init__(self) -> None:
        check_rate(self.rate, key="drive")
        msgspec.structs.force_setattr(self, "rate", float(self.rate))


Drive = OnEvent | FixedRate


def drive_of(given: Drive | float | str | None) -> Drive:
    """Return the drive that is given as itself, as ``"event"`` (the default), or as a rate in decisions a second.

    Raises:
        ConfigError: If it is nothing of these.
    """
    if given is None or (isinstance(given, str) and given == "event"):
        return OnEvent()
    if isinstance(given, OnEvent | FixedRate):
        return given
    if is_number(given):
        return FixedRate(float(given))
    raise ConfigError(
        f"a drive is 'event', a number of decisions per second, OnEvent() or FixedRate(rate), not {given!r}",
        key="drive",
    )


class ControlSettings(ControllerSettings, frozen=True, kw_only=True):
    """The options of a control layer: its controller's options, see `mdm.options.ControllerOptions`, and these.

    Attributes:
        drive: When to decide: ``OnEvent()`` or ``"event"`` (the default), on each state or observation; or
            ``FixedRate(rate)`` or a number, so many times a second.
        on_no_observation: The meaning of a fixed-rate tick without a new observation: ``predict`` (the default: time
            passes, nothing seen), ``repeat`` the last one, or the name of an observation.
        deadline: Seconds from stimulus to decision, or from the first of the ticks that were missed before it; of input
            from another thread, from when that told it. A later decision is reported, and where there is a safe action
            the ensemble goes safe in place of it. An answer of a search's fallback at the deadline is in time for a
            tenth of a second more.
    """

    drive: Any = None
    on_no_observation: str = "predict"
    deadline: Seconds | None = None


class ControlOptions(ControllerOptions, total=False):
    """The keyword arguments of `ControlSettings`."""

    drive: Drive | float | str | None
    on_no_observation: str
    deadline: float | None


class SafetySettings(ControlSettings, frozen=True, kw_only=True):
    """The options of an ensemble's layers and modes: those of its control layer, see `ControlOptions`, and these.

    Attributes:
        safe_timeout: Seconds that the safe action may take (10 by default).
        on_failed_action: An action that failed, timed out or was abandoned, where no predicate or event depends on that
            end: ``safe`` (the default where there is a safe action) or ``continue``. With ``decide`` it is decided
            again after each failure that nothing else is decided on, after the pause that the action's binding says.
        on_lost_input: A sensor's value that became older than its ``max_age``: the same two.
        on_unknown: A state, or a sensor of observations, that turns unknown otherwise: the same two.
        on_lost_teammate: In a team, this agent's reaction to one that was there and has not left in order:
            ``continue`` (the default: the team decides without it), ``hold`` (decided actions do not begin here until
            it is back), or ``safe_action``.
        after_safe: The belief after a safe action that is none of the model's: it starts again (``reset``,
            the default), or goes on by prediction (``keep``).
        idle_after: Seconds after which an ensemble that has nothing to do is told as a fault, unless the ended action's
            binding says ``then="wait"``; infinite for never. By default 10, where that action takes time or has failed,
            and the ensemble is of no team.
    """

    safe_timeout: Seconds = SAFE_TIMEOUT
    on_failed_action: FailureReaction | None = None
    on_lost_input: Reaction | None = None
    on_unknown: Reaction | None = None
    on_lost_teammate: LostTeammate | None = None
    after_safe: AfterSafe = "reset"
    idle_after: Annotated[float, Meta(gt=0, extra={"unit": "seconds"})] | None = None


class SafetyOptions(ControlOptions, total=False):
    """The keyword arguments of `SafetySettings`."""

    safe_timeout: float
    on_failed_action: FailureReaction | None
    on_lost_input: Reaction | None
    on_unknown: Reaction | None
    on_lost_teammate: LostTeammate | None
    after_safe: AfterSafe
    idle_after: float | None


class Sequel(Options, frozen=True):
    """A binding's declaration of how its action's end is followed.

    Attributes:
        then: ``decide``: where nothing else is decided within the pause, decide again on the same state or belief.
            ``wait``: wait for the next input, on purpose. By default it waits, too, and is told as idle.
        pause: Seconds before it is decided again, doubled with each failure in a row up to a minute.
        attempts: Failures in a row after which it is not decided again: ``Go.gave_up`` occurs, and where nothing
            depends on that, the ensemble goes safe. None by default: there are always more.
    """

    then: Then | None = None
    pause: Seconds = 1.0
    attempts: Annotated[int, Meta(ge=1)] | None = None

    @property
    def counts(self) -> bool:
        """Whether each end counts, a success of a plain function, too."""
        return self.then == "decide" or self.attempts is not None


class DriveSettings(Sequel, frozen=True, kw_only=True):
    """The options of a drive to a place: as of any action, see `Sequel`, and these.

    Attributes:
        timeout: Seconds after which a running life is cancelled and ends ``timed_out``.
        grace: Seconds that a cancelled task has to end before it is ``abandoned``.
        then: The sequel of its end: ``decide`` again, or ``wait``, on purpose.
        pause: Seconds before it is decided again.
        attempts: Failures in a row after which it is given up.
    """

    timeout: Seconds | None = None
    grace: Seconds = 5.0


class DriveOptions(TypedDict, total=False):
    """The keyword arguments of `DriveSettings`."""

    timeout: float | None
    grace: float
    then: Then | None
    pause: float
    attempts: int | None


class BindingSettings(DriveSettings, frozen=True, kw_only=True):
    """The options of an action: those of a drive, see `DriveOptions`, and these.

    Attributes:
        on_repeat: Whether a running task goes on when its action is chosen again (``continue``), or is
            cancelled and started again (``restart``). Take ``restart`` where the action's goal depends on the state
            in which it was chosen, such as "go up" in the next room: a task that goes on keeps its old goal.
        resume: For an ensemble: start it from the belief that it was stopped with.
        concurrent: The action neither ends the running one nor is ended by the next.
        group: Of tasks of the same group, such as drives to goals, the next one begins before the running one is
            cancelled, so that the device they drive need not stop in between. Any object that stands for the group.
        may_succeed: A task that returns after its cancellation has succeeded, as a drive that arrives meanwhile, and
            was not ``preempted`` or ``timed_out``. One of a group that was replaced is ``preempted`` all the same.
    """

    on_repeat: OnRepeat = "continue"
    resume: bool = False
    concurrent: bool = False
    group: Any = None
    may_succeed: bool = False


class BindingOptions(DriveOptions, total=False):
    """The keyword arguments of `BindingSettings`."""

    on_repeat: OnRepeat
    resume: bool
    concurrent: bool
    group: object
    may_succeed: bool


ControlOptions.__doc__ = ControlSettings.__doc__
SafetyOptions.__doc__ = SafetySettings.__doc__
DriveOptions.__doc__ = DriveSettings.__doc__
BindingOptions.__doc__ = BindingSettings.__doc__
