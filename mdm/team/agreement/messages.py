"""The messages by which agents agree on joint steps.

All are written as msgpack arrays that begin with the name of their kind, in a few microseconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import msgspec

from mdm.errors import Error
from mdm.team.agreement.log import START, Commit, Lineage, Members, Position, Term
from mdm.team.transport.bounds import UNREADABLE, Life, Name, Number, Order, Text, can_be

if TYPE_CHECKING:
    from collections.abc import Callable, Container

__all__ = [
    "Applied",
    "Begin",
    "Call",
    "Command",
    "Component",
    "Ended",
    "Entries",
    "Fetch",
    "Joined",
    "Message",
    "Send",
    "Snapshot",
    "Stale",
    "decode",
    "encode",
    "is_possible",
]

_STEP = 1000
"""Nanoseconds that a step takes at least."""


class Call(msgspec.Struct, frozen=True, array_like=True, tag="call", gc=False):
    """An agent calls the agents that it sees to a new term which it would lead."""

    term: Term
    members: Annotated[dict[Name, Life], msgspec.Meta(max_length=256)]


class Joined(msgspec.Struct, frozen=True, array_like=True, tag="joined", gc=False):
    """An agent has left all older terms for this one, and reports the steps that it has applied.

    Args:
        term: The term that was called.
        lineage: The last steps of the terms in this agent's history, its own position last.
        side: How many agents took part in the last step of that history.
        digest: Of its copy.
        sound: Whether it has no reason to doubt its copy.
    """

    term: Term
    lineage: Lineage
    side: Number
    digest: Text
    sound: bool


class Stale(msgspec.Struct, frozen=True, array_like=True, tag="stale", gc=False):
    """The message that this answers is of an older term than the sender's, which is this."""

    term: Term


class Ended(msgspec.Struct, frozen=True, array_like=True, tag="ended", gc=False):
    """The leader of this term sees no majority any more, and leads no further."""

    term: Term


class Begin(msgspec.Struct, frozen=True, array_like=True, tag="begin", gc=False):
    """The term has begun; its leader stands here."""

    term: Term
    position: Position
    digest: Text
    members: Members


class Component(msgspec.Struct, frozen=True, array_like=True, tag="component", gc=False):
    """The sender's component of this step alone; it has applied the step before. None: it saw nothing."""

    term: Term
    step: Number
    body: bytes | None


class Command(msgspec.Struct, frozen=True, array_like=True, tag="command", gc=False):
    """A command that was asked of the sender in this term, for this step; it has applied the step before."""

    term: Term
    step: Number
    command: Order
    token: Name = ""


class Applied(msgspec.Struct, frozen=True, array_like=True, tag="applied", gc=False):
    """The sender has applied the steps up to this one."""

    term: Term
    step: Number


class Fetch(msgspec.Struct, frozen=True, array_like=True, tag="fetch", gc=False):
    """The sender stands here and needs the next steps. With a digest: it doubts its copy, and needs a snapshot."""

    term: Term
    position: Position
    digest: Text | None


class Entries(msgspec.Struct, frozen=True, array_like=True, tag="entries", gc=False):
    """Steps in their order, of the history that this term goes on from or of the term itself."""

    term: Term
    commits: tuple[Commit, ...]


class Snapshot(msgspec.Struct, frozen=True, array_like=True, tag="snapshot", gc=False):
    """A whole copy, with its history."""

    term: Term
    lineage: Lineage
    side: Number
    digest: Text
    body: bytes


Message: TypeAlias = (
    Call | Joined | Stale | Ended | Begin | Component | Command | Commit | Applied | Fetch | Entries | Snapshot
)
"""A message from agent to agent."""


class Send(msgspec.Struct, frozen=True, gc=False):
    """A message on its way out; to one agent, or to everyone where ``to`` is None."""

    to: str | None
    message: Message


_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)

encode: Callable[[Message], bytes] = msgspec.msgpack.Encoder().encode
"""Returns a message as bytes."""


def decode(body: bytes) -> Message:
    """Return the message of bytes.

    Raises:
        Error: If it is none.
    """
    try:
        return _decoder.decode(body)
    except UNREADABLE as error:
        raise Error(f"this is no message of an agreement: {error}") from None


def is_possible(message: Message, agents: Container[str], now: int) -> bool:
    """Return whether the terms and steps of a message can be such.

    Args:
        message: A message of another machine.
        agents: The agents of the team.
        now: The receiver's time in nanoseconds since 1970.
    """
    term = message.term
    if not (term.leader in agents or term == START.term) or not can_be(term.number, now):
        return False
    step = getattr(message, "step", None)
    if step is not None:
        return can_be(step, now, _STEP)
    return all(at.term.number <= term.number and can_be(at.step, now, _STEP) for at in _positions(message))


def _positions(message: Message) -> tuple[Position, ...]:
    """Return the places in histories that a message tells of, besides a step of its own."""
    match message:
        case Begin() | Fetch():
            return (message.position,)
        case Joined() | Snapshot():
            return message.lineage
        case Entries():
            return tuple([Position(commit.term, commit.step) for commit in message.commits])
        case _:
            return ()
