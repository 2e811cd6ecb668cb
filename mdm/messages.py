"""Messages on channels: typed, frozen and cheap to create.

``time`` is the clock's time of the turn's *stimulus* in integer nanoseconds: all that the library publishes in a turn
has the same time, and a latency is one subtraction. Symbols are indices from 0; joint indices are row-major, with the
first factor or agent the most significant.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.texts import encodable

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
    "Heading",
    "Idle",
    "Journey",
    "Message",
    "Mode",
    "ModeName",
    "Observation",
    "ParticleUpdate",
    "PoseUpdate",
    "PredicateMap",
    "PredicateUpdate",
    "Progress",
    "Question",
    "Reward",
    "SensorUpdate",
    "State",
    "StateChange",
    "Tick",
]


class Message(msgspec.Struct, frozen=True, gc=False):
    """Base of all messages.

    The garbage collector does not track messages: they hold only scalars, strings, tuples and arrays, and cannot be
    part of a reference cycle.
    """

    time: int


class SensorUpdate(Message, frozen=True, gc=False):
    """Sensor input of one instant: new predicate values and raised events.

    Input of another thread waits for the event loop: ``time`` is when it was delivered there, and ``sensed`` when it
    was told, by which its age counts; else None.
    """

    predicates: tuple[tuple[str, bool | None], ...]
    events: tuple[str, ...] = ()
    sensed: int | None = None


class PoseUpdate(Message, frozen=True, gc=False):
    """Where a robot is, in the frame of its map: metres, and radians anticlockwise from the x axis.

    ``time`` is when it was there, and ``floor`` the floor in whose frame this is, where there are several.
    """

    x: float
    y: float
    yaw: float = 0.0
    floor: str = ""


class ParticleUpdate(Message, frozen=True, gc=False):
    """Where a robot may be: the particles of a filter, in metres in the frame of its map, and their weights.

    Without weights all particles count the same.
    """

    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    weights: npt.NDArray[np.float64] | None = None


class PredicateUpdate(Message, frozen=True, gc=False):
    """The predicates that changed in one turn; ``counter`` increases by one per update, so that gaps are detectable."""

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


class Heading(Message, frozen=True, gc=False):
    """A drive begins: by the way of that label from a place to another one, and why.

    ``label`` is empty, and ``source`` None, where the robot was sent to a place from anywhere.
    """

    label: str
    source: str | None
    target: str
    why: str


class Journey(Message, frozen=True, gc=False):
    """A drive to the goal of ``place`` is under way; none where that is None; ``arrived`` where it has ended there."""

    place: str | None
    arrived: bool = False


class Progress(Message, frozen=True, gc=False):
    """How far a drive is: the place that it leads to, and the metres that remain."""

    place: str
    remaining: float


class State(Message, frozen=True, gc=False):
    """A joint state; ``index`` is ``None`` while a factor is unknown, and so is that factor's entry in ``values``."""

    index: int | None
    values: tuple[int | None, ...]


class Observation(Message, frozen=True, gc=False):
    """A joint observation; ``index`` is ``None`` while a component is missing.

    ``mask`` tells for each component whether an event has set it again.
    """

    index: int | None
    values: tuple[int | None, ...]
    mask: tuple[bool, ...]


class Belief(Message, frozen=True, gc=False):
    """A probability distribution over states: a read-only array of S numbers."""

    probabilities: npt.NDArray[np.float64]


class Action(Message, frozen=True, gc=False):
    """A decided joint action, with the number of the decision since the last start, and the state decided on.

    Where it was decided on a belief, by a plan, or elsewhere, ``state`` is None. Where a shield has taken it in place
    of another one, which the policy's original would have done, that is ``wanted``; else None.
    """

    epoch: int
    index: int
    state: int | None = None
    wanted: int | None = None


class Reward(Message, frozen=True, gc=False):
    """The immediate reward of a decision: R(s, a), or its expectation under the belief."""

    epoch: int
    value: float


class Decision(Message, frozen=True, gc=False, omit_defaults=True):
    """A decision with its stimulus, information state and action.

    ``cause`` names the stimulus: ``start``, ``resume``, ``reset``, ``state``, ``observation``, ``belief``, ``tick``,
    ``episode`` (the stimulus after a horizon, which starts a new episode), ``release`` (the end of a safe mode),
    ``again`` (an action's end, or failure, after which it is decided once more where nothing else was decided; or
    `Ensemble.decide_again`), or
    ``team`` (what a team's controller, or this agent of a communicating team, has decided).

    ``wanted`` and ``wanted_name`` are those of the action in whose place a shield has taken this one; else None.
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
    wanted: int | None = None
    wanted_name: str | None = None


ActionStatus = Literal["running", "succeeded", "failed", "preempted", "timed_out", "abandoned"]


class ActionLife(Message, frozen=True, gc=False):
    """A change in the life of an action: ``running``, then exactly one end."""

    ensemble: str
    life: int
    action: str
    status: ActionStatus
    detail: str = ""


class Control(Message, frozen=True, gc=False):
    """A command to an ensemble; ``release`` ends its safe mode, ``decide_again`` has it decide on the present input."""

    command: Literal["start", "stop", "reset", "resume", "release", "decide_again"]


ModeName = Literal["stopped", "deciding", "safe"]


class Cause(msgspec.Struct, frozen=True, gc=False):
    """A cause of an ensemble's safe mode: its kind, a description, and its beginning in nanoseconds."""

    kind: str
    detail: str
    since: int

    def __str__(self) -> str:
        return f"{self.kind} since {self.since / 1e9:g} s: {self.detail}"


class Mode(Message, frozen=True, gc=False):
    """The new mode of an ensemble, and the causes if it is safe; ``since`` is the beginning of the mode."""

    ensemble: str
    mode: ModeName
    since: int
    causes: tuple[Cause, ...] = ()


class Idle(Message, frozen=True, gc=False):
    """An ensemble that decides has nothing to do, or has again; ``since`` is when that began, in nanoseconds.

    ``action`` is the one that has ended, empty where none was decided; ``intended`` whether its binding says
    ``then="wait"``.
    """

    ensemble: str
    idle: bool
    since: int
    action: str
    intended: bool


class Tick(Message, frozen=True, gc=False):
    """A fixed-rate tick: ``time`` is when it was due, ``late`` its delay in nanoseconds."""

    number: int
    late: int
    missed: int


class Question(Message, frozen=True, gc=False):
    """A control layer's request to its planner for an action in a state or belief; ``number`` counts requests."""

    number: int
    at: Any


class Answer(Message, frozen=True, gc=False):
    """A planner's answer to the question of that number, and its origin; ``action`` is None without an answer.

    ``time`` is that of the question's stimulus, and ``wanted`` the action in whose place a shield has taken this one;
    else None.
    """

    number: int
    action: int | None
    source: Literal["search", "fallback", "nothing"]
    wanted: int | None = None


class Fault(Message, frozen=True, gc=False):
    """A fault: the actor's path, the kind, and a description, made `encodable`."""

    source: str
    kind: str
    detail: str

    def __post_init__(self) -> None:
        if isinstance(self.detail, str):
            msgspec.structs.force_setattr(self, "detail", encodable(self.detail))


class StateChange(Message, frozen=True, gc=False):
    """A change in the life of an actor."""

    actor: str
    state: Literal["starting", "running", "restarting", "stopping", "stopped", "failed"]
