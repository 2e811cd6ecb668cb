"""The transport, which carries the messages of a team.

There are two, which keep the same promises: `mdm.team.transport.session.Session` between processes, over Zenoh, and the
transports of a simulated `mdm.team.transport.network.Network` within one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

import msgspec

from mdm.runtime.statistics import Histogram

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

PROTOCOL = 2
"""The version of the protocol between agents, which they compare from 2 on; those of two versions refuse each other.

In version 1 the updates of communicating teams were sent on the channel ``word``, and the layers of teams had other
names: ``centre`` and ``outpost`` in centralised teams, ``talker`` in communicating ones. A record of that version is
repeated with these.
"""

DOUBLE = "double"
"""The channel on which agents are asked for another process that has the name of one of them."""

LONGEST_CLOSE = 3.0
"""Seconds within which a transport closes."""

Priority = Literal["step", "value", "bulk"]
"""How urgent a message is: one of an agreed step, a value of which the newest counts, or one that can wait."""


class Sample(msgspec.Struct, frozen=True, gc=False):
    """A message of another agent, checked, without its envelope.

    Args:
        key: The full key under which it was put.
        owner: The agent that put it.
        incarnation: Which life of that agent: another one after each restart, and mostly a greater.
        body: The bytes that were put.
        time: When, by the clock of its owner, in nanoseconds.
    """

    key: str
    owner: str
    incarnation: int
    body: bytes
    time: int = 0


class Traffic(msgspec.Struct, frozen=True):
    """How many messages there were under a key, and their bytes with envelopes."""

    messages: int = 0
    bytes: int = 0


class TransportStatistics(msgspec.Struct, frozen=True):
    """Counts of an agent's transport.

    Args:
        sent: Messages that were put, by key.
        received: Messages that handlers received, by key. Beyond some thousand keys the rest is counted under ``...``.
        dropped: Messages that were not put or not handed over, by the reason:

            - ``malformed``, ``version`` (of a newer program), ``oversize``, ``foreign`` (under the key of another
              agent), ``stale`` (of an earlier life of its owner), ``repeated`` (not newer than the last of its key);
            - ``renumbered``: not a message, but the numbers of a key went on far behind its last, which was forged;
            - ``missing``: a gap in the numbers of a key says that they were lost on the way;
            - ``overflow``: more came than the handlers could take, and newer ones of the same keys took their place;
            - ``duplicate``: not a message, but another live agent of this one's name was seen;
            - ``untimely``: the clock of its sender is more than a day from this agent's;
            - ``incredible``: its fields cannot be, such as an action that the model has not;
            - ``ignored``: its sender has sent a hundred such messages within a second;
            - ``held_back``: over the allowance of this agent; ``closed``: put after the transport was closed.
        refused: Of these, messages that no agent of this program sends, by the agent in whose name it came.
        lost: Of the ``missing`` ones, how many each agent had sent.
        lateness: From each put to its handler, by the clocks of both agents.
        round_trips: From each question to its answer, by agent.
    """

    sent: dict[str, Traffic]
    received: dict[str, Traffic]
    dropped: dict[str, int]
    refused: dict[str, int]
    lost: dict[str, int]
    lateness: Histogram
    round_trips: dict[str, Histogram]


class Transport(Protocol):
    """Carries the messages of one agent of a team.

    Handlers are called on the event loop, never for the agent's own messages. The messages of one key come in the order
    in which they were put, each at most once; a message that is lost on the way is counted, not sent again. A key keeps
    to one priority: more urgent messages overtake others.
    """

    @property
    def agent(self) -> str:
        """The agent's name."""

    @property
    def incarnation(self) -> int:
        """Which life of the agent this is; a later one has another number, a greater where no clock was set back."""

    @property
    def protocol(self) -> int:
        """The version of the protocol that the agent speaks: `PROTOCOL`, or that of the record that is repeated."""

    async def open(self) -> None:
        """Take part; return once messages to the handlers given so far arrive wherever this agent is seen.

        Raises:
            Error: If that cannot be, such as with an endpoint that is in use, or a name that a live agent has.
        """

    async def close(self) -> None:
        """Leave. May be called again, does not hang, and no handler is called after it."""

    def put(self, key: str, body: bytes, *, priority: Priority = "value") -> bool:
        """Send to all who subscribed; never blocks.

        Returns:
            False where it was held back or dropped here, and counted. True promises nothing about its arrival.

        Raises:
            Error: Before `open`, under the key of another agent, or with a body that is too large for every receiver.
        """

    def subscribe(self, expression: str, handler: Callable[[Sample], None]) -> None:
        """Call a handler with each message under the keys of an expression, from now on.

        Of an expression given after `open` the other agents learn a moment later.
        """

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        """Answer requests under a key of this agent."""

    async def ask(self, expression: str, body: bytes = b"", *, timeout: float = 1.0) -> dict[str, bytes]:  # noqa: ASYNC109
        """Ask all who serve the keys of an expression; return the answers by agent.

        Those who do not answer within ``timeout`` seconds are left out.
        """

    def watch(self, handler: Callable[[Mapping[str, int]], None]) -> None:
        """Call a handler with the live agents and their incarnations, this one included: now and at each change.

        An agent is told of once messages to it arrive.
        """

    def supervise(self, failed: Callable[[BaseException], None], report: Callable[[str, str], None]) -> None:
        """Call ``failed`` with a handler's error, and ``report`` with a dropped message's kind and a sentence.

        Of each kind one report a second is made at most. Without a ``failed`` the event loop's handler of exceptions
        is told.
        """

    def refuse(self, sender: str, reason: str) -> None:
        """Take note of a message that a handler did not take: its fields cannot be, and a sentence says why.

        A sender of many is ignored for a while.
        """

    def statistics(self) -> TransportStatistics:
        """Return the counts so far."""
