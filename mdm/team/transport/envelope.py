"""The envelope of each message: who sent it, in which life, which number it has under its key, and in which form.

A receiver hands on a message that is whole, of a form that it knows, under a key of its sender, of the sender's present
life, and newer than the last of its key. Any other is refused by its kind.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.team.transport.keys import owner_of
from mdm.team.transport.transport import Sample

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["LARGEST", "VERSION", "Packer", "Refusal", "Unpacker", "check_size", "is_step"]

VERSION = 1
"""The form of envelopes and bodies that this program speaks; it grows when an older program could not read a newer."""

LARGEST = 1 << 20
"""The largest message in bytes, unless told otherwise."""

_MAGIC = b"mD"
_START = struct.Struct("<2sH?QB")  # magic, version, whether of a step, incarnation, bytes of the owner's name; the name
_REST = struct.Struct("<Qq")  # number, time; then the body
_MOST_KEYS = 4096
_NONE = -2  # a number that no other follows
_FAR = 1024  # further behind than that an owner's messages do not come, whatever overtakes them
_ENOUGH = 8
_APART = 250_000_000  # nanoseconds; two that come as far apart are enough: what comes again comes at once
_NO_START = b"no message begins so"
_MOST_MISSING = 1 << 20
_FRESH = 5_000_000_000  # nanoseconds for which a message is not taken for one that is sent again


class Refusal(Exception):
    """Why a message is not handed on.

    Args:
        kind: One word, as counted in `TransportStatistics.dropped`.
        reason: A sentence.
    """

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


class _Doubt:
    """Whether the last number under a key was one of its owner's: messages far behind it follow each other."""

    __slots__ = ("ahead", "count", "number", "since")

    def __init__(self, number: int, ahead: int, now: int) -> None:
        self.number = number
        self.count = 1
        self.ahead = ahead
        self.since = now

    def confirms(self, number: int, ahead: int, now: int) -> bool:
        """Take note of one more message; return whether there were so many, or over so long a time, that they count."""
        if number == self.number + 1 and ahead == self.ahead:
            self.count += 1
        else:
            self.count, self.since = 1, now
        self.number, self.ahead = number, ahead
        return self.count >= _ENOUGH or (self.count > 1 and number < ahead and now - self.since >= _APART)


class Packer:
    """Puts the messages of an agent in envelopes, numbered from 1 under each key.

    Args:
        owner: The agent.
        incarnation: Which life of it.
        now: The time in nanoseconds.
        version: The form of the bodies.
        largest: The largest message in bytes.

    Attributes:
        sent: By key, the number of its messages, which is that of the last, and their bytes.
    """

    def __init__(
        self,
        owner: str,
        incarnation: int,
        now: Callable[[], int],
        *,
        version: int = VERSION,
        largest: int = LARGEST,
    ) -> None:
        name = owner.encode()
        self._starts = tuple(
            _START.pack(_MAGIC, version, step, incarnation, len(name)) + name for step in (False, True)
        )
        self._now = now
        self._largest = largest
        self.sent: dict[str, list[int]] = {}

    def pack(self, key: str, body: bytes, *, step: bool = False) -> bytes:
        """Return the next message under a key; one of an agreed step is given up last where there are too many.

        Raises:
            Error: If every receiver would drop it, since it is too large.
        """
        counts = self.sent.get(key)
        if counts is None:
            counts = self.sent[key] = [0, 0]
        data = self._starts[step] + _REST.pack(counts[0] + 1, self._now()) + body
        size = len(data)
        if size > self._largest:
            check_size(key, data, self._largest)
        counts[0] += 1
        counts[1] += size
        return data

    def size(self, body: bytes) -> int:
        """Return the bytes of a message with its envelope."""
        return len(self._starts[0]) + _REST.size + len(body)

    def seal(self, body: bytes) -> bytes:
        """Return a message without a number: a question or an answer."""
        return self._starts[0] + _REST.pack(0, self._now()) + body


class _Last:
    """The last message under a key: how it began, its number, and how many were left out if it was its owner's."""

    __slots__ = ("incarnation", "leap", "length", "number", "owner", "start")

    def __init__(self, owner: str, incarnation: int, number: int, start: bytes, leap: int = 0) -> None:
        self.owner = owner
        self.incarnation = incarnation
        self.number = number
        self.leap = leap
        self.start = _NO_START if leap else start  # else the next is taken without a look at this
        self.length = len(start)


class Unpacker:
    """Takes the messages of others out of their envelopes, and refuses those that must not be handed on.

    Args:
        team: Whose keys.
        agent: Who receives.
        largest: The largest message in bytes.
        missing: Called with a key and the number of its messages that were lost before the one that came.
        renumbered: Called with a key whose last number cannot have been its owner's, such as a forged one far ahead:
            some messages far behind it that follow each other are then gone on from.
    """

    def __init__(
        self,
        team: str,
        agent: str,
        missing: Callable[[str, int], None],
        renumbered: Callable[[str], None] = lambda _: None,
        *,
        largest: int = LARGEST,
    ) -> None:
        self.largest = largest
        self._team = team
        self._agent = agent
        self._missing = missing
        self._renumbered = renumbered
        self._present: dict[str, int] = {}
        self._last: dict[str, _Last] = {}
        self._excused: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self._doubts: dict[str, _Doubt] = {}

    def present(self, owner: str, incarnation: int) -> None:
        """Take this for the present life of an agent, because it is seen to live; messages of other lives are stale.

        It may be less than that of an earlier life, where a clock was set back.
        """
        self._seen[owner] = incarnation
        self._begin(owner, incarnation)

    def _begin(self, owner: str, incarnation: int) -> None:
        if self._present.get(owner) != incarnation:
            self._present[owner] = incarnation
            for last in self._last.values():
                if last.owner == owner and last.incarnation != incarnation:
                    last.number = _NONE

    def excuse(self, key: str, count: int) -> None:
        """Do not miss so many messages under a key: they came, and were superseded."""
        if key in self._last:
            self._excused[key] = self._excused.get(key, 0) + count

    def unpack(self, key: str, data: bytes, now: int = 0) -> Sample:
        """Return the message under a key.

        Args:
            key: The key.
            data: With its envelope.
            now: The time in nanoseconds, by which messages that are sent again are told from new ones.

        Raises:
            Refusal: If it must not be handed on.
        """
        # Every message comes here. Nearly all begin as the last of their key did, and are the next: these take a third
        # of the time that it takes to look at all of an envelope.
        last = self._last.get(key)
        if last is not None and data.startswith(last.start) and len(data) <= self.largest:
            length = last.length
            try:
                number, time = _REST.unpack_from(data, length)
            except struct.error:
                raise Refusal("malformed", f"a message under {key} is shorter than an envelope") from None
            if number == last.number + 1:
                last.number = number
                return Sample(key, last.owner, last.incarnation, data[length + 16 :], time)
        return self._unpack(key, data, last, now)

    def _unpack(self, key: str, data: bytes, last: _Last | None, now: int) -> Sample:
        owner, incarnation, number, time, start = _open(key, data, self.largest)
        if owner != owner_of(key, self._team):
            raise Refusal("foreign", f"agent {owner!r} sent under {key}, where it is not the owner")
        if owner == self._agent:
            raise Refusal("foreign", f"another process sent under {key}, of this agent")
        present = self._present.get(owner, 0)
        if incarnation < present and incarnation != self._seen.get(owner):
            raise Refusal("stale", f"a message under {key} is of an earlier life of agent {owner!r}")
        self._begin(owner, incarnation)
        leap = 0  # what one message tells that is far ahead counts when the next is there, and for so many at most
        if last is None:
            if len(self._last) >= _MOST_KEYS:
                oldest = next(iter(self._last))
                del self._last[oldest]
                self._excused.pop(oldest, None)
                self._doubts.pop(oldest, None)
        elif last.incarnation == incarnation and last.number != _NONE:
            missed = number - last.number - 1
            if missed < 0:
                self._doubt(key, number, last.number, now, fresh=0 < now < time + _FRESH)
                missed = 0
            elif missed > _FAR and last.leap == 0:
                leap, missed = missed, 0
            else:
                missed = min(missed + last.leap, _MOST_MISSING)
            missed -= 0 if leap else self._excused.pop(key, 0)
            if missed > 0:
                self._missing(key, missed)
        self._last[key] = _Last(owner, incarnation, number, data[:start], leap)
        return Sample(key, owner, incarnation, data[start + _REST.size :], time)

    def _doubt(self, key: str, number: int, ahead: int, now: int, *, fresh: bool) -> None:
        """Refuse a message that is behind the last of its key, unless that cannot have been its owner's.

        It cannot where it is far ahead of others that follow each other, or of such as were sent only now.

        Raises:
            Refusal: Nearly always.
        """
        if fresh or ahead - number > _FAR:
            doubt = self._doubts.setdefault(key, _Doubt(number, ahead, now))
            if doubt.number != number and doubt.confirms(number, ahead, now):
                del self._doubts[key]
                self._renumbered(key)
                return
        raise Refusal("repeated", f"a message under {key} came again, or after a newer one")

    def unseal(self, key: str, data: bytes, *, of_owner: bool) -> Sample:
        """Return a question or an answer; an answer is of the owner of the key.

        Raises:
            Refusal: If it must not be handed on.
        """
        owner, incarnation, _, time, start = _open(key, data, self.largest)
        if of_owner and owner != owner_of(key, self._team):
            raise Refusal("foreign", f"agent {owner!r} answered under {key}, where it is not the owner")
        return Sample(key, owner, incarnation, data[start + _REST.size :], time)


def is_step(data: bytes) -> bool:
    """Whether a message in its envelope says that it is one of an agreed step."""
    return data[4:5] == b"\1"


def check_size(key: str, data: bytes, largest: int) -> None:
    """Refuse to send a message that every receiver would drop.

    Raises:
        Error: If it is larger than the limit.
    """
    if len(data) > largest:
        raise Error(f"a message under {key} has {len(data):,} bytes, and at most {largest:,} are taken")


def _open(key: str, data: bytes, largest: int) -> tuple[str, int, int, int, int]:
    """Return the owner, its incarnation, the number, the time, and where the last two stand."""
    if len(data) > largest:
        raise Refusal("oversize", f"a message under {key} has {len(data):,} bytes, and at most {largest:,} are taken")
    try:
        magic, version, _, incarnation, length = _START.unpack_from(data)
        if magic == _MAGIC and version != VERSION:
            raise Refusal(
                "version", f"a message under {key} is of version {version}, and this program reads version {VERSION}"
            )
        start = _START.size + length
        number, time = _REST.unpack_from(data, start)
    except struct.error:
        raise Refusal("malformed", f"a message under {key} is shorter than an envelope") from None
    if magic != _MAGIC:
        raise Refusal("malformed", f"a message under {key} is not of this program")
    if incarnation >> 63:
        raise Refusal("malformed", f"a message under {key} is of life {incarnation}, which no agent has")
    try:
        owner = data[_START.size : start].decode()
    except UnicodeDecodeError:
        raise Refusal("malformed", f"a message under {key} names no owner") from None
    return owner, incarnation, number, time, start
