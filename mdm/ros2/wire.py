"""The wire of a link: the part of ROS 2 that it needs, so that others can carry it than rclpy.

A wire's handles are made before it opens. Messages of topics are heard in its own thread; all else is heard and
answered on the event loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import msgspec
from msgspec import Meta

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from mdm.runtime import Runtime

Role = Literal["publisher", "subscription", "service", "action"]
"""What another node is to a name: it publishes or subscribes to a topic, or serves a service or an action."""

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""How a goal ends: the codes of ``action_msgs/msg/GoalStatus``."""
UNKNOWN, ENDED = 2, 3
"""Why a goal is not cancelled: the server knows none such, or it has ended; as in ``action_msgs/srv/CancelGoal``."""


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
            raise ValueError(
                "kept messages (transient_local) reach reliable subscriptions: say reliability = 'reliable'"
            )


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


class Publisher(Protocol):
    """Publishes on one topic."""

    def __call__(self, message: Any, /) -> None:
        """Publish a message; from the event loop."""

    @property
    def matched(self) -> int:
        """How many subscriptions there are."""


class Client(Protocol):
    """Calls one service."""

    @property
    def ready(self) -> bool:
        """Whether a server is there."""

    def __call__(self, request: Any, /) -> Awaitable[Any]:
        """Return the response; cancelled, it is no longer waited for."""


class Goal(Protocol):
    """A goal that a server has answered."""

    @property
    def accepted(self) -> bool:
        """Whether the server pursues it."""

    def end(self) -> Awaitable[tuple[int, Any]]:
        """Return the status by which it ends and its result; may be awaited again, also after a cancellation."""

    def cancel(self) -> Awaitable[int]:
        """Ask the server to cancel it; return the code that it answers: 0, 1 (it refuses), `UNKNOWN` or `ENDED`."""


class Goals(Protocol):
    """Sends goals to one action's server."""

    @property
    def ready(self) -> bool:
        """Whether a server is there."""

    def send(self, goal: Any, feedback: Callable[[Any], object], status: Callable[[int], object], /) -> Awaitable[Goal]:
        """Send a goal; return when the server has answered. Shield it: a goal on its way is accepted all the same.

        Args:
            goal: Its message.
            feedback: Hears each feedback message of this goal, on the event loop.
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

    def publish(self, topic: str, kind: str, quality: Quality, /) -> Publisher:
        """Return a publisher on a topic."""

    def call(self, service: str, kind: str, /) -> Client:
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
