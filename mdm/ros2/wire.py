"""The wire of a link: the part of ROS 2 that it needs, so that others can carry it than rclpy.

A wire's handles are made before it opens. Messages of topics are heard in its own thread; all else is heard and
answered on the event loop.
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import msgspec
from msgspec import Meta

from mdm.errors import Error
from mdm.logic import similar
from mdm.messages import Fault

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence

    from mdm.runtime import Runtime

Role = Literal["publisher", "subscription", "service", "action"]
"""What another node is to a name: it publishes or subscribes to a topic, or serves a service or an action."""

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""How a goal ends: the codes of ``action_msgs/msg/GoalStatus``."""
UNKNOWN, ENDED = 2, 3
"""Why a goal is not cancelled: the server knows none such, or it has ended; as in ``action_msgs/srv/CancelGoal``."""

_PARTS = r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*"
_FORMS = {"node": r"[A-Za-z_]\w*", "namespace": rf"/?({_PARTS})?/?", "name": rf"(~?/)?{_PARTS}"}
_PART = r"Request|Response|Goal|Result|Feedback"
_KIND = re.compile(rf"([a-z]\w*)/(msg|srv|action)/([A-Z][A-Za-z0-9]*)(?:_({_PART}))?", re.ASCII)


class Quality(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The quality of service of a topic.

    Attributes:
        depth: Messages that wait at most, in DDS, before the oldest is dropped without a word.
        reliability: ``best_effort`` meets every publisher, ``reliable`` only a reliable one.
        durability: ``transient_local`` also gets the message that a publisher keeps, where both are reliable.
    """

    depth: Annotated[int, Meta(ge=1, le=100_000)] = 10
    reliability: Literal["reliable", "best_effort"] = "best_effort"
    durability: Literal["volatile", "transient_local"] = "volatile"

    def __post_init__(self) -> None:
        if self.durability == "transient_local" and self.reliability == "best_effort":
            way = "say reliability = 'reliable'"
            raise ValueError(f"kept messages (transient_local) reach reliable subscriptions: {way}")


class WireError(Error):
    """A wire cannot carry something: the type, the field or the server is named in the text."""


class Peer(msgspec.Struct, frozen=True):
    """Another node's end of a topic, a service or an action.

    Attributes:
        node: Its node, with the namespace, such as ``/robot1/amcl``.
        kind: Its type.
        quality: Its quality of service; None of services and actions.
    """

    node: str
    kind: str
    quality: Quality | None = None


class Handle(Protocol):
    """This side of a topic that is published, a service or an action; called from the event loop."""

    @property
    def ready(self) -> bool:
        """Whether somebody is at the other end."""


class Caller(Handle, Protocol):
    """Publishes on one topic, or calls one service."""

    def __call__(self, message: Any, /) -> Any:
        """Publish a message; or return, to be awaited, the response to a request."""


class Goal(Protocol):
    """A goal that was sent; all may be awaited again, also after a cancellation."""

    def accepted(self) -> Awaitable[bool]:
        """Return whether the server pursues it, when it has answered."""

    def end(self) -> Awaitable[tuple[int, Any]]:
        """Return the status by which it ends, 0 where it was not accepted, and its result."""

    def cancel(self) -> Awaitable[int]:
        """Ask the server to cancel it; return the code that it answers: 0, 1 (it refuses), `UNKNOWN` or `ENDED`."""


class Goals(Handle, Protocol):
    """Sends goals to one action's server."""

    def send(self, goal: Any, feedback: Callable[[Any], object], status: Callable[[int], object], /) -> Goal:
        """Send a goal.

        Args:
            goal: Its message.
            feedback: Hears this goal's feedback, on the event loop: the newest in place of one that waits.
            status: Hears each status code of this goal, on the event loop.
        """


class Wire(Protocol):
    """Carries topics, services and actions; ``RclpyWire`` is the wire over the user's rclpy, and others can be written.

    Types are named as in ROS, such as ``sensor_msgs/msg/BatteryState``. An invalid name or type is a `WireError` where
    the handle is made.
    """

    def make(self, kind: str, fields: Mapping[str, Any], /) -> Any:
        """Return a message (or a service's request, or an action's goal) with these fields; others have their default.

        Raises:
            WireError: If a field is none of the type's, or its value does not fit: names both.
        """

    def fields(self, kind: str, /) -> Mapping[str, str]:
        """Return the type of each field of a type, by name."""

    def subscribe(self, topic: str, kind: str, hear: Callable[[Any], object], quality: Quality, /) -> None:
        """Hear each message of a topic, in the wire's thread; an exception of ``hear`` is a fault, and nothing more."""

    def publish(self, topic: str, kind: str, quality: Quality, /) -> Caller:
        """Return a publisher on a topic."""

    def call(self, service: str, kind: str, /) -> Caller:
        """Return a client of a service."""

    def action(self, name: str, kind: str, /) -> Goals:
        """Return a sender of goals to an action's server."""

    def serve(self, service: str, kind: str, answer: Callable[[Any], Any], /) -> None:
        """Answer a service; ``answer`` is called on the event loop, with a request, and returns the response."""

    def peers(self, role: Role, name: str, /) -> Sequence[Peer]:
        """Return who has this role for a topic, a service or an action now, as ROS' graph says; remapped as all names.

        The graph notices a node that ended without a farewell after some 20 s.
        """

    async def open(self, runtime: Runtime) -> None:
        """Begin to carry."""

    async def close(self) -> None:
        """End, and give all back."""


def check_name(name: str, role: str = "name") -> None:
    """Refuse, as a `WireError`, a name that no topic, service or action can have; or no ``node`` or ``namespace``."""
    if not re.fullmatch(_FORMS[role], name, re.ASCII):
        raise WireError(
            f"{name!r} cannot be a {role} of ROS 2: that has parts of letters, digits and _, none of which begins with "
            "a digit, and one / between them"
        )


def check_node(node: str, namespace: str, remap: Mapping[str, str]) -> None:
    """Refuse, as a `WireError`, a node's name, its namespace, or a name that stands for another, if it can be none."""
    check_name(node, "node")
    check_name(namespace, "namespace")
    for name in (*remap, *remap.values()):
        check_name(name)


def parts_of(kind: str, whole: str = "") -> tuple[str, str, str, str | None]:
    """Return the package, folder, name and part that a type names, as in ``std_srvs/srv/SetBool_Response``.

    Raises:
        WireError: If it has another form; or, where a ``whole`` (msg, srv or action) is needed, is none.
    """
    found = _KIND.fullmatch(kind)
    if found is None or (whole and (found[2] != whole or found[4])):
        form = f"package/{whole or 'msg'}/Name"
        raise WireError(f"{kind!r} does not name a type of ROS 2 that is needed here, which has the form {form}")
    return found[1], found[2], found[3], found[4]


def near(name: str, known: Iterable[str]) -> str:
    """Return which name may have been meant, as the end of a sentence."""
    names = [each for each in known if not each.startswith("_")]
    return similar(name, names) or (f"; there are {', '.join(names)}" if names else "")


def report(runtime: Runtime, name: str, kind: str, detail: str) -> None:
    """Publish a fault of a topic, a service or an action; from any thread."""
    with suppress(Error):  # another process's, after a fork
        runtime.faults.publish(Fault(runtime.now(), f"ros2/{name.lstrip('/')}", kind, detail))
