"""Stimuli: the beginnings of turns, as a record keeps them, so that a run can be repeated from them alone.

Messages that the library derives from a stimulus are none: those of timers, predicates of places, ends of actions as
events. ``time`` is that of the turn which the stimulus begins, in nanoseconds of the clock.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol

import msgspec

from mdm.messages import (
    Action,
    Answer,
    Control,
    EventUpdate,
    Observation,
    PredicateUpdate,
    Question,
    SensorUpdate,
    State,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "TRUE_REWARD",
    "TRUE_STATE",
    "Acknowledged",
    "Answered",
    "Asked",
    "Began",
    "Behind",
    "Commanded",
    "Cut",
    "Delays",
    "Ended",
    "Failed",
    "Finished",
    "GoesOn",
    "Joined",
    "Kept",
    "Lasts",
    "Late",
    "Opened",
    "Over",
    "Raised",
    "Recalled",
    "Received",
    "Resumed",
    "Said",
    "Seen",
    "Stimulus",
    "Ticked",
    "Unsent",
    "Where",
    "count_messages",
]

Where = Literal["outside", "call", "task", "turn"]
"""Where users' code said something: outside of all turns; within the call of an action, or in its task, both of a life
with a number; or elsewhere within a turn, as in a handler of their own."""

_COUNTED = frozenset(
    {Action, Answer, Control, EventUpdate, Observation, PredicateUpdate, Question, SensorUpdate, State}
)


class _Counted(Protocol):
    """A channel, as far as it counts its messages."""

    @property
    def type(self) -> Any: ...

    published: int


def count_messages(channels: Iterable[_Counted]) -> int:
    """Return how many messages the channels have carried that lead to decisions: how far a turn has come."""
    return sum([channel.published for channel in channels if channel.type in _COUNTED])


class Delays:
    """Counts the delays that each actor asks for in a turn."""

    def __init__(self) -> None:
        self._time = -1
        self._asked: dict[str, int] = {}

    def count(self, actor: str, time: int) -> int:
        """Count a delay of an actor in the turn of a time; return its number, from 0 on."""
        if time != self._time:
            self._time, self._asked = time, {}
        number = self._asked.get(actor, 0)
        self._asked[actor] = number + 1
        return number


TRUE_REWARD, TRUE_STATE = "true_reward", "true_state"
"""The name of the channel, behind an ensemble's path, on which a simulated world tells its state: a record keeps it."""


class _Stimulus(msgspec.Struct, frozen=True, gc=False, tag_field="kind", tag=str.lower):
    time: int


class Began(_Stimulus, frozen=True, gc=False):
    """An actor came to a step of its life: its start when `on_start` is called, ``run`` when `on_running` is.

    An ensemble comes to its ``stop`` when its end begins, for good or before it starts again; every actor comes to its
    ``end`` when it hears nothing more.
    """

    actor: str
    step: Literal["start", "run", "stop", "end"]


class Failed(_Stimulus, frozen=True, gc=False):
    """An actor failed, by itself or with another that did before."""

    actor: str
    error: str


class Kept(_Stimulus, frozen=True, gc=False):
    """Sensors had told a predicate manager values before it started; ``times`` says when, where that is known."""

    actor: str
    values: dict[str, bool | None]
    times: dict[str, int]


class Said(_Stimulus, frozen=True, gc=False):
    """A message was published on a channel that the library takes input from.

    ``type`` is the message's class; ``ensemble`` and ``life`` are those of the action whose code said it, where
    ``where`` is ``call`` or ``task``. Where it is ``turn``, ``after`` is how many messages had been published by then,
    see `count_messages`: its place in that turn.
    """

    channel: str
    type: str
    message: Any
    where: Where = "outside"
    ensemble: str = ""
    life: int = 0
    after: int = 0


class Ticked(_Stimulus, frozen=True, gc=False):
    """A fixed-rate tick of an actor came, due at ``time``, for itself and ``missed`` ones before it.

    ``rate`` tells which of its tickers it is, by ticks a second.
    """

    actor: str
    number: int
    missed: int
    rate: float


class Lasts(_Stimulus, frozen=True, gc=False):
    """The function of an action's life returned an awaitable, which runs as work."""

    ensemble: str
    life: int


class Ended(_Stimulus, frozen=True, gc=False):
    """The work of an action's life came to its end.

    ``interrupted`` tells that a cancellation had reached it by then, ``error`` names its error, where it raised one;
    ``cancelled`` that it was cancelled, by whomever; ``abandoned`` that the life had ended long before.
    """

    ensemble: str
    life: int
    interrupted: bool
    cancelled: bool
    error: str | None = None
    abandoned: bool = False


class Raised(_Stimulus, frozen=True, gc=False):
    """The function of an action raised within its call; ``unrun`` where it returned something that never ran."""

    ensemble: str
    life: int
    error: str
    unrun: bool = False


class GoesOn(_Stimulus, frozen=True, gc=False):
    """The answer of an action's ``goes_on`` when the action was chosen again, by the decision of an epoch."""

    ensemble: str
    epoch: int
    answer: bool


class Over(_Stimulus, frozen=True, gc=False):
    """The task of a life, 0 in older records, was over when an epoch's decision met it, and its end on the way."""

    ensemble: str
    epoch: int
    life: int = 0


class Late(_Stimulus, frozen=True, gc=False):
    """A decision came so many nanoseconds after its stimulus, past its deadline."""

    ensemble: str
    epoch: int
    latency: int


class Behind(_Stimulus, frozen=True, gc=False):
    """A turn was so far behind the clock that a delay, an actor's ``number``-th in it, counted from ``begin``."""

    actor: str
    number: int
    begin: int


class Cut(_Stimulus, frozen=True, gc=False):
    """The turn of this time was cut short; ``after`` is how many messages had been published, see `count_messages`."""

    after: int


class Resumed(_Stimulus, frozen=True, gc=False):
    """The turn that was cut short went on; ``starved`` where other input had come for too long by then."""

    starved: bool = False


class Joined(_Stimulus, frozen=True, gc=False):
    """An agent of a team began its link to the others, in a life of this number.

    ``facts`` are those that must be the same at all agents, by name: they refuse each other where one differs.
    ``protocol`` is the version of the agent's messages to them.
    """

    agent: str
    incarnation: int
    facts: dict[str, str] = {}
    protocol: int = 1


class Opened(_Stimulus, frozen=True, gc=False):
    """An agent's link to its team was open."""

    agent: str


class Seen(_Stimulus, frozen=True, gc=False):
    """Agents of the team were live, by the numbers of their lives."""

    agent: str
    live: dict[str, int]


class Received(_Stimulus, frozen=True, gc=False):
    """A message of another agent came, under a key that an expression has; ``sent`` is when, by its owner's clock."""

    agent: str
    expression: str
    key: str
    owner: str
    incarnation: int
    sent: int
    body: bytes


class Unsent(_Stimulus, frozen=True, gc=False):
    """A message of this agent was held back, the one of this number that it put."""

    agent: str
    number: int


class Asked(_Stimulus, frozen=True, gc=False):
    """Another agent asked this one for something that it tells from then on."""

    agent: str
    key: str
    body: bytes


class Answered(_Stimulus, frozen=True, gc=False):
    """An actor got an answer of another agent that it had asked for."""

    actor: str
    body: bytes


class Acknowledged(_Stimulus, frozen=True, gc=False):
    """A layer had the chance to acknowledge a step to its team, behind the immediate consequences of the step."""

    actor: str


class Commanded(_Stimulus, frozen=True, gc=False):
    """Somebody asked this agent, from outside, for a command to the team."""

    ensemble: str
    command: str
    token: str | None


class Recalled(_Stimulus, frozen=True, gc=False):
    """A layer of a team began as an earlier process of its agent had stopped; ``stored`` is JSON."""

    ensemble: str
    stored: bytes


class Finished(_Stimulus, frozen=True, gc=False):
    """The runtime began to end; ``within`` a turn, as where a signal came, which may have gone on."""

    within: bool = False


Stimulus = (
    Began
    | Failed
    | Kept
    | Said
    | Ticked
    | Lasts
    | Ended
    | Raised
    | GoesOn
    | Over
    | Late
    | Behind
    | Cut
    | Resumed
    | Joined
    | Opened
    | Seen
    | Received
    | Unsent
    | Acknowledged
    | Answered
    | Asked
    | Commanded
    | Recalled
    | Finished
)
"""One of them; ``kind`` in JSON is the name of its class in small letters."""
