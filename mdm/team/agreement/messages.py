"""The messages by which agents agree on joint steps, and the places in histories that they name.

All are written as msgpack arrays that begin with the name of their kind, in a few microseconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import msgspec

from mdm.errors import Error
from mdm.team.transport.bounds import UNREADABLE, Life, Name, Number, Order, Text, can_be

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Sequence

_STEP = 1000
"""Nanoseconds that a step takes at least."""


class Term(msgspec.Struct, frozen=True, order=True, array_like=True, gc=False):
    """A time in which one agent leads; a later one is greater. No two calls of any agents make the same.

    Args:
        number: Grows with each change of membership.
        leader: The agent that called it.
        incarnation: Which life of that agent.
    """

    number: Number
    leader: Name
    incarnation: Life


class Position(msgspec.Struct, frozen=True, order=True, array_like=True, gc=False):
    """A place in a history: the last step that was applied, and the term that committed it."""

    term: Term
    step: Number


Lineage: TypeAlias = Annotated[tuple[Position, ...], msgspec.Meta(min_length=1, max_length=64)]
Members: TypeAlias = Annotated[tuple[Name, ...], msgspec.Meta(max_length=256)]
"""The last steps of the terms in a history; its own last step is the last of them."""

START = Position(Term(0, "", 0), 0)
"""Where every history begins: nothing was applied."""


class Commit(msgspec.Struct, frozen=True, array_like=True, tag="commit", gc=False):
    """A joint step, which every copy applies in its turn.

    Args:
        term: Who committed it, and when.
        step: Counted from 1, over all terms.
        previous: The term of the step before: together with ``step`` it says which history this goes on.
        inputs: The components by agent, in the order of the team; an agent that saw nothing has none.
        missing: Agents whose component is not known.
        command: ``"start"``, ``"stop"``, ``"reset"``…: such a step has neither inputs nor missing agents.
        by: Who gave the command.
        digest: Of the leader's copy after the step before.
        token: The identifier of the command.
    """

    term: Term
    step: Number
    previous: Term
    inputs: Annotated[dict[Name, bytes], msgspec.Meta(max_length=256)]
    missing: Members
    command: Order | None
    by: Name
    digest: Text
    token: Name = ""


def contains(lineage: Sequence[Position], position: Position) -> bool:
    """Return whether a history of this lineage has a position in it."""
    return any(last.term == position.term and position.step <= last.step for last in lineage)


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
        raise Error(f"this is not a message of an agreement: {error}") from None


def is_possible(message: Message, agents: Container[str], now: int) -> bool:
    """Return whether the terms and steps of a message can be such."""
    term = message.term
    if not (term.leader in agents or term == START.term) or not can_be(term.number, now):
        return False
    step = getattr(message, "step", None)
    if step is not None:
        return can_be(step, now, _STEP)
    return all(at.term.number <= term.number and can_be(at.step, now, _STEP) for at in _positions(message))


def _positions(message: Message) -> tuple[Position, ...]:
    """Return the places in histories that a message names, besides a step of its own."""
    match message:
        case Begin() | Fetch():
            return (message.position,)
        case Joined() | Snapshot():
            return message.lineage
        case Entries():
            return tuple([Position(commit.term, commit.step) for commit in message.commits])
        case _:
            return ()
