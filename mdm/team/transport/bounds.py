"""Bounds of messages of other machines: the types of fields, and checks that depend on the receiver's clock.

A message is checked once, where it enters: its decoder refuses bytes that no sender of this program sends, and `can_be`
numbers for which there was no time. Indices are checked where the model's spaces are known.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

UNREADABLE = (msgspec.MsgspecError, ValueError, RecursionError)
"""The errors of decoders where bytes are no message; the last where values lie too deep within each other."""

HOUR = 3_600_000_000_000
"""Nanoseconds by which counts and numbers may be ahead of the receiver's clock."""

DAY = 24 * HOUR
"""Nanoseconds by which the clock of a sender may differ from the receiver's; its messages are dropped beyond."""

Number: TypeAlias = Annotated[int, Meta(ge=0, le=(1 << 62) - 1)]
"""A count or a time since 1970, which is never negative and has room to grow."""

Offset: TypeAlias = Annotated[int, Meta(ge=-(1 << 62) + 1, le=(1 << 62) - 1)]
"""How far one clock is ahead of another."""

Life: TypeAlias = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
"""An incarnation."""

Name: TypeAlias = Annotated[str, Meta(max_length=256)]
"""The name of an agent, a predicate or a command."""

Order: TypeAlias = Annotated[str, Meta(pattern=r"^(begin|hold|reset|resume|start|stop)\Z")]
"""A command of a team. Any other word orders nothing; least of all does it start one."""

Text: TypeAlias = Annotated[str, Meta(max_length=4096)]
"""A sentence or a digest."""


def can_be(number: int, now: int, each: int = 1_000_000) -> bool:
    """Return whether so many things can have happened by a time.

    Changes of membership and commands of a team take a millisecond each at least. All receivers draw the same line,
    but for their clocks, and a count that goes on from a number at the line is behind it again a millisecond later.

    Args:
        number: How many.
        now: The receiver's time in nanoseconds since 1970.
        each: How many nanoseconds each of them takes at least.
    """
    return number * each <= now + HOUR
