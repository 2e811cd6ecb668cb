"""Stimuli: what begins turns, as a record keeps it, so that a run can be repeated from them alone.

What the library derives from a stimulus is no stimulus: timers and what follows from them, predicates of places, ends
of actions as events. ``time`` is that of the turn which the stimulus begins, in nanoseconds of the clock.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

__all__ = ["Began", "Ended", "Finished", "GoesOn", "Lasts", "Late", "Raised", "Said", "Stimulus", "Ticked", "Where"]

Where = Literal["outside", "call", "task", "turn"]
"""Where users' code said something: outside of all turns; within the call of an action, or in its task, both of a life
with a number; or elsewhere within a turn, as in a handler of their own."""


class _Stimulus(msgspec.Struct, frozen=True, gc=False, tag_field="kind", tag=str.lower):
    time: int


class Began(_Stimulus, frozen=True, gc=False):
    """An actor came to a step of its start: ``start`` when `on_start` is called, ``run`` when `on_running` is."""

    actor: str
    step: Literal["start", "run"]


class Said(_Stimulus, frozen=True, gc=False):
    """A message was published on a channel that the library takes input from.

    ``type`` is the message's class; ``ensemble`` and ``life`` are those of the action whose code said it, where
    ``where`` is ``call`` or ``task``.
    """

    channel: str
    type: str
    message: Any
    where: Where = "outside"
    ensemble: str = ""
    life: int = 0


class Ticked(_Stimulus, frozen=True, gc=False):
    """A fixed-rate tick of an actor came, due at ``time``, for itself and ``missed`` ones before it."""

    actor: str
    number: int
    missed: int


class Lasts(_Stimulus, frozen=True, gc=False):
    """The function of an action's life returned an awaitable, which runs as work."""

    ensemble: str
    life: int


class Ended(_Stimulus, frozen=True, gc=False):
    """The work of an action's life came to its end.

    ``interrupted`` tells that a cancellation had reached it by then, ``error`` what it raised, where it did;
    ``cancelled`` that it was cancelled, by whomever.
    """

    ensemble: str
    life: int
    interrupted: bool
    cancelled: bool
    error: str | None = None


class Raised(_Stimulus, frozen=True, gc=False):
    """The function of an action raised within its call; ``unrun`` where it returned something that never ran."""

    ensemble: str
    life: int
    error: str
    unrun: bool = False


class GoesOn(_Stimulus, frozen=True, gc=False):
    """What an action's ``goes_on`` answered when the action was chosen again, by the decision of an epoch."""

    ensemble: str
    epoch: int
    answer: bool


class Late(_Stimulus, frozen=True, gc=False):
    """A decision came so many nanoseconds after its stimulus, past its deadline."""

    ensemble: str
    epoch: int
    latency: int


class Finished(_Stimulus, frozen=True, gc=False):
    """The runtime began to end."""


Stimulus = Began | Said | Ticked | Lasts | Ended | Raised | GoesOn | Late | Finished
"""One of them; ``kind`` in JSON is the name of its class in small letters."""
