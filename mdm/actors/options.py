"""The options of control layers and of ensembles: one typed dictionary each, for Python, files and commands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from mdm.options import ControllerOptions

if TYPE_CHECKING:
    from mdm.actors.control.drive import Drive

__all__ = ["AfterSafe", "ControlOptions", "FailureReaction", "LostTeammate", "Reaction", "SafetyOptions"]

Reaction = Literal["safe", "continue"]
FailureReaction = Literal["safe", "continue", "decide"]
LostTeammate = Literal["continue", "hold", "safe_action"]
AfterSafe = Literal["reset", "keep"]


class ControlOptions(ControllerOptions, total=False):
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

    drive: Drive | float | str | None
    on_no_observation: str
    deadline: float | None


class SafetyOptions(ControlOptions, total=False):
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
        after_safe: The belief after a safe action that is none of the model's: it starts anew (``reset``,
            the default), or goes on by prediction (``keep``).
        idle_after: Seconds after which an ensemble that has nothing to do is told as a fault, unless the ended action's
            binding says ``then="wait"``; infinite for never. By default 10, where that action takes time or has failed,
            and the ensemble is of no team.
    """

    safe_timeout: float
    on_failed_action: FailureReaction | None
    on_lost_input: Reaction | None
    on_unknown: Reaction | None
    on_lost_teammate: LostTeammate | None
    after_safe: AfterSafe
    idle_after: float | None
