"""Every message that crosses a channel: typed, frozen, and cheap to make.

``time`` is always the clock's integer nanoseconds at which the *stimulus* of the turn happened, so that all messages
of one turn carry the same stamp and a latency is one subtraction. Symbols are indices from 0; a joint index is
row-major with the first factor or agent the most significant.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec
import numpy as np
import numpy.typing as npt

__all__ = [
    "Action",
    "ActionLife",
    "Answer",
    "Belief",
    "Cause",
    "Control",
    "Decision",
    "EventUpdate",
    "Fault",
    "Message",
    "Mode",
    "ModeName",
    "Observation",
    "PredicateMap",
    "PredicateUpdate",
    "Question",
    "Reward",
    "SensorUpdate",
    "State",
    "StateChange",
    "Tick",
]


class Message(msgspec.Struct, frozen=True, gc=False):
    """Base of all messages.

    Messages are kept out of the garbage collector's sight: they hold only scalars, strings, tuples and arrays, and so
    can be part of no reference cycle.
    """

    time: int


class SensorUpdate(Message, frozen=True, gc=False):
    """What the sensors said at one instant: new predicate values and raised events."""

    predicates: tuple[tuple[str, bool | None], ...]
    events: tuple[str, ...] = ()


class PredicateUpdate(Message, frozen=True, gc=False):
    """The predicates that changed in one turn; ``counter`` grows by one with each update, so that a gap shows."""

    counter: int
    rising: tuple[str, ...]
    falling: tuple[str, ...]
    unknown: tuple[str, ...]


class EventUpdate(Message, frozen=True, gc=False):
    """The events that occurred in one turn."""

    counter: int
    events: tuple[str, ...]


class PredicateMap(Message, frozen=True, gc=False):
    """The value of every predicate; ``None`` is unknown."""

    counter: int
    values: dict[str, bool | None]


class State(Message, frozen=True, gc=False):
    """A joint state; ``index`` is ``None`` while a factor is unknown (its entry in ``values`` is then ``None``)."""

    index: int | None
    values: tuple[int | None, ...]


class Observation(Message, frozen=True, gc=False):
    """A joint observation; ``index`` is ``None`` while a component is missing.

    ``mask`` says of each component whether an event made it new.
    """

    index: int | None
    values: tuple[int | None, ...]
    mask: tuple[bool, ...]


class Belief(Message, frozen=True, gc=False):
    """A probability distribution over states (a read-only array of S numbers)."""

    probabilities: npt.NDArray[np.float64]


class Action(Message, frozen=True, gc=False):
    """A decided joint action, with the number of its decision since the last start."""

    epoch: int
    index: int


class Reward(Message, frozen=True, gc=False):
    """The immediate reward of a decision: R(s, a), or its expectation under the belief."""

    epoch: int
    value: float


class Decision(Message, frozen=True, gc=False):
    """Everything about one decision, for logs, records and tests.

    ``cause`` names the stimulus: ``start``, ``resume``, ``reset``, ``state``, ``observation``, ``belief``, ``tick``,
    ``episode`` (the stimulus after a horizon, which starts a new episode), or ``release`` (the end of a safe mode).
    """

    ensemble: str
    epoch: int
    cause: str
    state: int | None
    observation: int | tuple[int | None, ...] | None
    belief: npt.NDArray[np.float64] | None
    action: int
    action_name: str
    reward: float | None


ActionStatus = Literal["running", "succeeded", "failed", "preempted", "timed_out", "abandoned"]


class ActionLife(Message, frozen=True, gc=False):
    """A step in the life of an action: ``running``, then exactly one of the ends."""

    ensemble: str
    life: int
    action: str
    status: ActionStatus
    detail: str = ""


class Control(Message, frozen=True, gc=False):
    """A command to an ensemble; ``release`` ends its safe mode."""

    command: Literal["start", "stop", "reset", "resume", "release"]


ModeName = Literal["stopped", "deciding", "safe"]


class Cause(msgspec.Struct, frozen=True, gc=False):
    """Why an ensemble is safe: a kind, in words, and since when (nanoseconds)."""

    kind: str
    detail: str
    since: int


class Mode(Message, frozen=True, gc=False):
    """The mode that an ensemble is in from now on, and why it is safe; ``since`` is when the mode began."""

    ensemble: str
    mode: ModeName
    since: int
    causes: tuple[Cause, ...] = ()


class Tick(Message, frozen=True, gc=False):
    """A fixed-rate tick: ``time`` is when it was due, ``late`` how many nanoseconds later it came."""

    number: int
    late: int
    missed: int


class Question(Message, frozen=True, gc=False):
    """What a control layer asks its planner: the action for a state index or a belief; ``number`` counts questions."""

    number: int
    at: Any


class Answer(Message, frozen=True, gc=False):
    """What a planner answers to the question of that number, and what chose it; ``action`` is None where nothing did.

    ``time`` is that of the question's stimulus.
    """

    number: int
    action: int | None
    source: Literal["search", "fallback", "nothing"]


class Fault(Message, frozen=True, gc=False):
    """Something went wrong: who (an actor's path), what (a kind), and in words."""

    source: str
    kind: str
    detail: str


class StateChange(Message, frozen=True, gc=False):
    """An actor's life moved on."""

    actor: str
    state: Literal["starting", "running", "restarting", "stopping", "stopped", "failed"]
