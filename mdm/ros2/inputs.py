"""Topics as input: a message says whether predicates hold, raises events, or tells where the robot is.

A topic is heard in the wire's thread, which keeps the newest message and wakes the event loop: there all that it says
is one update, as old as the message is. Nothing piles up, however fast messages come and however large they are.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, get_args

from mdm.actors.predicates.sources import truth
from mdm.errors import ConfigError
from mdm.messages import Message, PoseUpdate, SensorUpdate
from mdm.ros2.conditions import Condition
from mdm.ros2.wire import report
from mdm.runtime.handler import check_plain
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from mdm.actors import PredicateManager
    from mdm.maps import Places
    from mdm.ros2.wire import Quality, Wire
    from mdm.runtime import Runtime

When = Condition | Callable[[Any], "bool | None"]
PoseKind = Literal[
    "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"
]
"""The types of messages that tell a pose."""
_OLD, _AHEAD = 5.0, 1.0
"""Seconds by which a stamp may be behind the clock, and ahead of it."""


class Heard(Message, frozen=True, gc=False):
    """A topic has a message that was not taken yet."""


class Topic:
    """A topic that is subscribed to, and all that its messages say; `mdm.ros2.Link.topic` makes it.

    ``when`` is a condition, see `mdm.ros2.Condition`, or a function that gets a message, in the event loop, and returns
    True, False, or None for unknown. One that raises is a fault, and unknown.

    Attributes:
        heard: How many messages came.
        lost: How many were dropped before a function was asked whether they raise an event.
    """

    def __init__(self, wire: Wire, predicates: PredicateManager, name: str, kind: str, quality: Quality) -> None:
        self.name, self.kind, self.quality = name, kind, quality
        self.heard = self.lost = 0
        self._fields = wire.fields
        self._predicates = predicates
        self._values: list[tuple[str, When]] = []
        self._events: list[tuple[str, Condition | None]] = []
        self._asked: list[tuple[str, When]] = []
        self._places: tuple[Places, float] | None = None
        self._waiting: deque[tuple[int, Any]] = deque(maxlen=1)
        wire.subscribe(name, kind, self._hear, quality)

    def predicate(self, name: str, when: str | When, max_age: float | None = None) -> None:
        """Declare a predicate that the newest message decides; unknown ``max_age`` seconds after that came.

        Raises:
            ConfigError: If the name is taken, or no message can meet the condition.
            FormatError: If it is none.
        """
        self._predicates.sensor(name, max_age=max_age)
        self._values.append((name, self._when(name, when)))

    def event(self, name: str, when: str | When | None = None) -> None:
        """Declare an event that each message raises, or each for which ``when`` holds.

        A condition leaves no message out. Of messages that wait to be looked at by a function there are no more than
        the ``depth`` of the quality; a fault counts the others.
        """
        self._predicates.event(name)
        told = self._when(name, when)
        if told is None or isinstance(told, Condition):
            self._events.append((name, told))
        else:
            self._asked.append((name, told))
            self._waiting = deque(maxlen=self.quality.depth)

    def pose(self, places: Places, covariance: float = 0.5) -> None:
        """Tell places where the robot is, in the frame of their map, which counts for their ``max_age``.

        A pose is taken up to a variance of ``covariance``, in m², along the axis in which it is least certain.
        """
        if self.kind not in get_args(PoseKind):
            raise ConfigError(f"a pose is told by {', '.join(get_args(PoseKind))}, not by {self.kind}")
        self._places = places, covariance

    def _when(self, name: str, given: str | When | None) -> Any:
        if isinstance(given, str):
            given = Condition(given)
        if isinstance(given, Condition):
            given.check(self.kind, self._fields)
        elif given is not None:
            check_plain(given, f"the 'when' of {name!r}")
        worded = getattr(given, "__qualname__", given or "each message")
        self._predicates.declared.tellers[name] = f"{self.name}: {worded}"
        return given

    def open(self, runtime: Runtime) -> None:
        """Take all that is heard from now on."""
        self._runtime = runtime
        self._told: set[str] = set()
        self._newest: tuple[int, Any] | None = None
        self._waiting.clear()
        for _, when in (*self._values, *self._events):
            if isinstance(when, Condition):
                when.begin()
        self._channel = runtime.channel(f"ros2/{self.name.lstrip('/')}", Heard)
        self._channel.supersedes = lambda _: self.name
        self._channel.subscribe(self._take)
        runtime.lives.subscribe(self._locate)

    def _hear(self, message: Any) -> None:
        """Take a message, in the wire's thread."""
        now = self._runtime.clock.now()
        self.heard += 1
        if self._asked and len(self._waiting) == self._waiting.maxlen:
            self.lost += 1
        self._waiting.append((now, message))
        self._channel.publish(Heard(now))
        for name, when in self._events:
            if when is None or when(message):
                self._predicates.occur(name)

    def _take(self, _: Heard) -> None:
        """Let the newest message say what holds, and functions of each one whether it raises events."""
        arrived = [self._waiting.popleft() for _ in range(len(self._waiting))]
        if not arrived:
            return  # an earlier turn has taken it
        for since, message in arrived if self._asked else ():
            if events := [name for name, when in self._asked if self._holds(name, when, message)]:
                self._say(since, (), tuple(events))
        since, message = self._newest = arrived[-1]
        self._look_at_stamp(message, since)
        if self._values:
            self._say(since, tuple([(name, self._holds(name, when, message)) for name, when in self._values]))
        self._locate()

    def _say(self, since: int, values: tuple[tuple[str, bool | None], ...], events: tuple[str, ...] = ()) -> None:
        predicates = self._predicates
        if predicates.life == "running" and not predicates.failing:
            predicates.sensed.publish(SensorUpdate(self._runtime.now(), values, events, since))
        else:  # it is kept for the start
            for name, value in values:
                predicates.sense(name, value)

    def _holds(self, name: str, when: When, message: Any) -> bool | None:
        try:
            return truth(name, when(message))
        except Exception as error:
            self._tell("sensor", f"the 'when' of {name!r} has failed, which counts as unknown: {describe(error)}", name)
            return None

    def _look_at_stamp(self, message: Any, since: int) -> None:
        if self.lost:
            self._tell("overflow", f"messages came faster than functions were asked: {self.lost:,} were lost")
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        seconds = 0.0 if stamp is None else stamp.sec + stamp.nanosec / 1e9
        age = since / 1e9 - seconds
        old = age > _OLD and self.quality.durability == "volatile"  # else its publisher may have kept it
        if seconds and (old or age < -_AHEAD):
            told = f"{abs(age):.3g} s {'old' if old else 'ahead of the clock'}"
            self._tell("clock", f"the stamp of a message is {told}; its age counts from when it came")

    def _locate(self, _: object = None) -> None:
        """Tell the newest pose, as soon as the places run, where it is certain enough."""
        if self._places is None or self._newest is None or self._places[0].life != "running":
            return
        (places, most), (since, message), self._newest = self._places, self._newest, None
        pose, variance = getattr(message.pose, "pose", message.pose), _variance(message.pose)
        if (frame := message.header.frame_id).rpartition("/")[2] not in {"", "map"}:
            self._tell("pose", f"poses in the frame {frame!r} are taken as of the map: there is no tf2 here", "frame")
        if 0 <= variance <= most:
            at, q = pose.position, pose.orientation
            yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
            places.channel("pose", PoseUpdate).publish(PoseUpdate(since, at.x, at.y, yaw))
        else:
            self._tell("pose", f"a pose with a variance of {variance:.3g} m² is not taken: at most {most:g} is")

    def _tell(self, kind: str, detail: str, about: str = "") -> None:
        """Publish a fault, once of each kind and predicate."""
        if kind + about not in self._told:
            self._told.add(kind + about)
            report(self._runtime, self.name, kind, detail)


def _variance(pose: Any) -> float:
    """Return the variance of a place along the axis in which it is least certain, in m²; 0 without a covariance."""
    if not hasattr(pose, "covariance"):
        return 0.0
    xx, xy, yy = (float(pose.covariance[index]) for index in (0, 1, 7))
    return (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
